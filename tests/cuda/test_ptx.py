"""The PTX of the kernels, interpreted instruction by instruction, gives the CPU's bits.

The simulator runs the same source compiled by Numba for the CPU; this runs the PTX.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from extras import need

need("numba_cuda")

import fake_driver
import raystream as rs
import test_float64 as float64
from cases import CASES
from conftest import CUDA_TRACERS, FLOAT64_CUDA_TRACERS, GPU_TRACERS
from mask_cases import check as check_masks
from mask_cases import left_of, of_all_kinds, of_instances, of_meshes, some_masks, some_rays
from meshes import soup
from ptx.driver import PtxDriver
from ptx.machine import Kernel, Memory, PtxError
from ptx.memory import room_for
from raystream.jit.cpu import kernel
from raystream.jit.cuda import CAPABILITIES, RangeKernel, devices, is_simulated, open_gpu
from raystream.jit.views import view
from scene_cases import FIRST, SCENE_CASES, assert_answers, assert_same, some_of
from test_agreement import answers_of, assert_expected, case_of, rays_of
from test_closest_point import assert_same_bits, points_around

pytestmark = pytest.mark.skipif(is_simulated(), reason="the simulator has no compiler")

#: A device number that no other test uses: compiled kernels are cached by it.
NUMBER = 7

#: Rays of a case, spread over all of them: a ray is some thousand instructions.
RAY_COUNT = 10

#: Cases for float64 by brute force, which takes long.
FEW_CASES = ("exact_edges_on_a_lattice", "limits_at_the_hits_themselves", "random_soup")


@pytest.fixture
def driver(monkeypatch):
    """A device that runs PTX."""
    made = PtxDriver()
    made.count = NUMBER + 1
    fake_driver.install(monkeypatch, made)
    yield made
    devices._opened.cache_clear()


def few_of(case):
    rows = np.linspace(0, len(case.origins) - 1, RAY_COUNT).astype(int)
    limits = (limit[rows] for limit in case.limits())
    t_min, t_max = limits
    origins, directions = case.origins[rows], case.directions[rows]
    return replace(case, origins=origins, directions=directions, t_min=t_min, t_max=t_max)


def assert_brute_force(name, **options):
    case = few_of(case_of(name))
    tracer = rs.Tracer(case.scene, gpu=NUMBER, **options)
    answers = answers_of(tracer, rays_of(case), is_brief=True)
    assert_expected(answers, answers_of(rs.Tracer(case.scene, "brute"), rays_of(case)))


def test_a_bvh_equals_brute_force(driver):
    case = few_of(case_of("random_soup"))
    tracer = rs.Tracer(case.scene, device="cuda", gpu=NUMBER)
    hits = tracer.first_hit(**rays_of(case))
    expected = rs.Tracer(case.scene, "brute").first_hit(**rays_of(case))
    for name in ("t", "u", "v", "prim_id"):
        assert getattr(hits, name).tobytes() == getattr(expected, name).tobytes()
    assert any("first_hit" in name for name in driver.launched)


@pytest.mark.exhaustive
@pytest.mark.usefixtures("driver")
@pytest.mark.parametrize(
    ("tracer", "name"), [(tracer, name) for tracer in CUDA_TRACERS for name in CASES]
)
def test_structures_equal_brute_force(tracer, name):
    assert_brute_force(name, **CUDA_TRACERS[tracer])


@pytest.mark.exhaustive
@pytest.mark.usefixtures("driver")
@pytest.mark.parametrize("tracer", GPU_TRACERS)
def test_builds_equal_brute_force(tracer):
    assert_brute_force("random_soup", **GPU_TRACERS[tracer])


#: Scenes with instances, spheres and height fields that a default run has; kernels for them are
#: compiled in some seconds.
FEW_SCENES = ("bvh", "worlds"), ("bvh", "primitives_of_all_kinds"), ("brute", "placed_limits")


@pytest.mark.parametrize(
    ("structure", "name"),
    [
        pytest.param(
            structure,
            name,
            marks=[pytest.mark.exhaustive] * ((structure, name) not in FEW_SCENES),
        )
        for structure in ("bvh", "brute")
        for name in SCENE_CASES
    ],
)
def test_instances_and_primitives_equal_brute_force(driver, structure, name):
    scene, rays = SCENE_CASES[name](np.random.default_rng(2013))
    rays = some_of(rays, RAY_COUNT)
    tracer, oracle = rs.Tracer(scene, structure, "cuda", gpu=NUMBER), rs.Tracer(scene, "brute")
    assert assert_answers(tracer, oracle, rays, limits=(None, 2)) > 0
    on_device = {one: Lent(open_gpu(NUMBER), values) for one, values in rays.items()}
    assert_same(tracer.first_hit(**on_device).host(), oracle.first_hit(**rays), FIRST)
    assert any("multi_hit" in kernel for kernel in driver.launched)


@pytest.mark.usefixtures("driver")
@pytest.mark.parametrize(
    ("structure", "make", "precision"),
    [
        ("bvh", of_instances, "float32"),
        *(
            pytest.param(*one, marks=pytest.mark.exhaustive)
            for one in (
                ("bvh", of_meshes, "float32"),
                ("bvh", of_meshes, "float64"),
                ("bvh", of_all_kinds, "float32"),
                ("brute", of_instances, "float32"),
                ("grid", of_meshes, "float32"),
            )
        ),
    ],
)
def test_masks_give_the_bits_without_the_parts(structure, make, precision):
    case, options = make(), {"precision": precision}
    tracer = rs.Tracer(case.scene, structure, "cuda", gpu=NUMBER, **options)
    rays, masks = some_rays(9, 1, True), some_masks(9)
    check_masks(tracer, left_of(case, np.unique(masks), **options), rays, masks)


@pytest.mark.usefixtures("driver")
@pytest.mark.parametrize(
    ("tracer", "name"),
    [
        pytest.param(
            tracer,
            name,
            marks=[pytest.mark.exhaustive] * ((tracer, name) != ("bvh, float64", "random_soup")),
        )
        for i, tracer in enumerate(FLOAT64_CUDA_TRACERS)
        for name in (FEW_CASES if i else CASES)
    ],
)
def test_float64_is_exact_with_the_cpus_bits(tracer, name):
    case = few_of(case_of(name))
    made = rs.Tracer(case.scene, gpu=NUMBER, **FLOAT64_CUDA_TRACERS[tracer])
    float64.assert_right(case.scene, made, rays_of(case), 4)


@pytest.mark.parametrize("structure", ["brute", "bvh"])
def test_closest_points_equal_brute_force(driver, structure):
    vertices, faces = soup(24, 3)
    scene = rs.Scene.from_arrays(vertices, faces)
    points = points_around(vertices, np.random.default_rng(4), 6)
    expected = rs.Tracer(scene, "brute").closest_points(points, 2)
    found = rs.Tracer(scene, structure, "cuda", gpu=NUMBER).closest_points(points, 2)
    assert_same_bits(found, expected)
    assert any("find_nearest" in name for name in driver.launched)


@pytest.mark.parametrize(
    "name", ["mirrors_and_uneven_scales", "primitives_of_all_kinds", "float64"]
)
def test_closest_points_of_all_kinds_equal_brute_force(driver, name):
    if name == "float64":
        scene, options = rs.Scene.from_arrays(*soup(24, 3)), {"precision": "float64"}
    else:
        scene, options = SCENE_CASES[name](np.random.default_rng(2013))[0], {}
    points = points_around(np.array(scene.bounds), np.random.default_rng(4), 6)
    expected = rs.Tracer(scene, "brute", **options).closest_points(points, 2)
    found = rs.Tracer(scene, device="cuda", gpu=NUMBER, **options).closest_points(points, 2)
    assert_same_bits(found, expected)
    assert any("find_nearest" in name for name in driver.launched)


class Lent:
    """An array on the device, as CuPy lends one."""

    def __init__(self, gpu, array):
        self._array = gpu.upload("rays", np.ascontiguousarray(array))
        self.__cuda_array_interface__ = self._array.__cuda_array_interface__


@pytest.mark.exhaustive
@pytest.mark.usefixtures("driver")
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_arrays_on_the_device_are_traced_where_they_are(dtype):
    case = few_of(case_of("random_soup"))
    rays = [np.asarray(one, np.float32).astype(dtype) for one in (case.origins, case.directions)]
    expected, gpu = rs.Tracer(case.scene, "brute"), open_gpu(NUMBER)
    tracer = rs.Tracer(case.scene, device="cuda", gpu=NUMBER)
    origins, directions = (Lent(gpu, one) for one in rays)
    hits = tracer.first_hit(origins, directions).host()
    theirs = expected.first_hit(*rays)
    for name in ("t", "u", "v", "prim_id"):
        assert getattr(hits, name).tobytes() == getattr(theirs, name).tobytes()
    every, all_theirs = tracer.multi_hit(origins, directions).host(), expected.multi_hit(*rays)
    assert every.ray_splits.tolist() == all_theirs.ray_splits.tolist()
    assert every.t.tobytes() == all_theirs.t.tobytes()
    # A limit for each ray has to be packed.
    t_max = np.linspace(0.1, 2.0, RAY_COUNT)
    blocked = tracer.any_hit(origins, directions, t_max=Lent(gpu, t_max)).host()
    assert blocked.tolist() == expected.any_hit(*rays, t_max=t_max).tolist()


def is_odd(hit):
    return rs.Decision.CONTINUE if hit.prim_id % 2 else rs.Decision.IGNORE


def add_up(hit, payload):
    payload[0] += hit.t
    payload[1] = hit.prim_id
    return rs.Decision.STOP if hit.t > 1.0 else rs.Decision.CONTINUE


@pytest.mark.exhaustive
def test_programs_give_what_they_give_on_the_cpu(driver, monkeypatch):
    case = few_of(case_of("random_soup"))
    rays, oracle = rays_of(case), rs.Tracer(case.scene, "brute")
    theirs = oracle.multi_hit(**rays, on_hit=is_odd)
    sums = oracle.trace(**rays, on_hit=add_up, payload=np.zeros((RAY_COUNT, 2), np.float32))
    tracer = rs.Tracer(case.scene, device="cuda", gpu=NUMBER)
    monkeypatch.setattr("raystream.programs.program.Program.run", None)
    ours = tracer.multi_hit(**rays, on_hit=is_odd)
    assert ours.ray_splits.tolist() == theirs.ray_splits.tolist()
    assert ours.t.tobytes() == theirs.t.tobytes()
    found = tracer.trace(**rays, on_hit=add_up, payload=np.zeros((RAY_COUNT, 2), np.float32))
    assert found.tobytes() == sums.tobytes()
    assert any("multi_hit" in name for name in driver.launched)


@pytest.mark.exhaustive
@pytest.mark.parametrize("mode", ["path", "kajiya", "ao", "raycast", "shadow", "vis"])
def test_pictures_are_the_processor_s(driver, mode):
    scene = rs.load("cornell")
    samples = 1 if mode in ("raycast", "vis", "shadow") else 2
    tracer = rs.Tracer(scene, device="cuda", gpu=NUMBER)
    ours, theirs = (rs.render(one, mode, (5, 4), samples=samples) for one in (tracer, scene))
    assert any("generate_camera_rays" in name for name in driver.launched)
    assert ours.pixels.tobytes() == theirs.pixels.tobytes()


# ---- The machine itself.


HEAD = ".version 8.8\n.target sm_75\n.address_size 64\n"


def run(body, *values, block_size=1, declared=""):
    """Run instructions with parameters p0, p1, ... of 8 bytes in registers %rd0, %rd1, ..."""
    parameters = ", ".join(f".param .b64 p{i}" for i in range(len(values)))
    loads = "\n".join(f"ld.param.u64 %rd{i}, [p{i}];" for i in range(len(values)))
    text = f"{HEAD}.visible .entry k({parameters})\n{{\n{declared}\n{loads}\n{body}\nret;\n}}\n"
    memory = Memory()
    arrays = [value for value in values if isinstance(value, np.ndarray)]
    for array in arrays:
        memory.add("an array", array.reshape(-1).view(np.uint8))
    given = [
        np.uint64(value.ctypes.data if isinstance(value, np.ndarray) else value) for value in values
    ]
    Kernel(text, "k").launch(memory, 1, block_size, given)


@pytest.mark.parametrize(
    ("body", "complaint"),
    [
        ("ld.u32 %r1, [%rd0+16];", "reads 4 bytes, of which 4 or more lie behind an array"),
        ("ld.u32 %r1, [%rd0+2];", "reads 4 bytes, 2 behind where they may begin"),
        ("ld.v4.f32 {%f1, %f2, %f3, %f4}, [%rd0+8];", "8 behind where they may begin"),
        ("st.u64 [%rd0+12], %rd0;", "writes 8 bytes, 4 behind"),
        ("mov.u64 %rd1, 64; ld.u32 %r1, [%rd1];", "at 0x40, where nothing is"),
        ("mul.f32 %f1, %f2, %f3;", "mul without '.rn' may be fused"),
        ("add.rn.ftz.f32 %f1, %f2, %f3;", "'.ftz' would round in another way"),
        ("tex.1d.v4.f32.f32 %f1, %f2;", "no such instruction is known: tex"),
        ("$L1:\nbra $L1;", "more than"),
    ],
)
def test_what_a_device_would_not_do_is_an_error(body, complaint, monkeypatch):
    monkeypatch.setattr("ptx.machine._MOST_STEPS", 1000)
    with pytest.raises(PtxError, match=complaint):
        run(body, room_for(16, 16))


RECORD = np.dtype(
    [
        ("flag", "u1"),
        ("unused", "V3"),
        ("number", "i4"),
        ("three", "f4", 3),
        ("four", "f4", 4),
        ("rows", "f4", (2, 2, 1)),
        ("inner", [("low", "f4"), ("count", "u4")]),
    ]
)
Record = view(RECORD)
ONE = np.uint64(1)


@kernel
def change_record(i, records):
    record = Record(records, i)
    x, y, z = record.three
    record.three = z, x, y
    record.four = record.four + record.rows[i, ONE]
    record.rows[ONE, i] = record.inner.low
    inner = record.inner
    inner.count += np.uint32(record.flag)
    record.flag, record.number = np.uint8(inner.count), -record.number


def test_records_are_read_and_written_by_their_fields_names():
    records = room_for(2 * RECORD.itemsize, 4)
    records[:] = np.random.default_rng(1).integers(0, 64, records.size)
    ours = records.view(RECORD)
    expected = ours.copy()
    expected["three"] = np.roll(expected["three"], 1, axis=1)
    for i, record in enumerate(expected):
        record["four"] += record["rows"][i, 1]
        record["rows"][1, i] = record["inner"]["low"]
    expected["inner"]["count"] += expected["flag"]
    expected["flag"], expected["number"] = expected["inner"]["count"], -expected["number"]

    made = RangeKernel(change_record).compiled((np.uint64(0),), CAPABILITIES[0])
    memory = Memory()
    memory.add("records", records)
    values = np.uint64(len(ours)), np.uint64(records.ctypes.data)
    Kernel(made.ptx, made.entry).launch(memory, 1, 4, values)
    assert ours.tobytes() == expected.tobytes()


FLOATS = np.array([0.0, -0.0, 1.5, -2.75, 1e30, -1e-40, np.inf, np.nan, 3.0000002], np.float32)


@pytest.mark.parametrize(
    ("instruction", "expected"),
    [
        ("add.rn.f32", np.add),
        ("mul.rn.f32", np.multiply),
        ("div.rn.f32", np.divide),
        ("min.f32", np.fmin),
        ("max.f32", np.fmax),
    ],
)
def test_floats_are_those_of_the_cpu(instruction, expected):
    a, b = (one.astype(np.float32).ravel() for one in np.meshgrid(FLOATS, FLOATS))
    a, b = a.copy(), b.copy()
    out = np.zeros_like(a)
    run(
        "mov.u32 %r1, %tid.x; mul.wide.u32 %rd3, %r1, 4;"
        "add.s64 %rd4, %rd0, %rd3; add.s64 %rd5, %rd1, %rd3; add.s64 %rd6, %rd2, %rd3;"
        f"ld.f32 %f1, [%rd4]; ld.f32 %f2, [%rd5]; {instruction} %f3, %f1, %f2; st.f32 [%rd6], %f3;",
        *(a, b, out),
        block_size=len(a),
    )
    with np.errstate(all="ignore"):
        np.testing.assert_array_equal(out, expected(a, b))


def test_integers_have_the_width_of_their_type():
    out = np.zeros(6, np.uint64)
    run(
        "mov.u32 %r1, -1; add.s32 %r2, %r1, 2; st.u32 [%rd0], %r2;"
        "shr.s32 %r3, %r1, 4; cvt.s64.s32 %rd1, %r3; st.u64 [%rd0+8], %rd1;"
        "cvt.u64.u32 %rd2, %r1; shl.b64 %rd3, %rd2, 40; st.u64 [%rd0+16], %rd3;"
        "mov.u64 %rd4, -7; div.s64 %rd5, %rd4, 2; st.u64 [%rd0+24], %rd5;"
        "rem.s64 %rd6, %rd4, 2; st.u64 [%rd0+32], %rd6;"
        "setp.lt.s32 %p1, %r1, 0; setp.lt.u32 %p2, %r1, 1; mov.u64 %rd7, 0;"
        "@%p1 add.s64 %rd7, %rd7, 1; @!%p2 add.s64 %rd7, %rd7, 2; st.u64 [%rd0+40], %rd7;",
        out,
    )
    assert out.view(np.int64).tolist() == [1, -1, -(1 << 40), -3, -1, 3]


def test_barriers_hold_until_all_are_there():
    """Each thread reads what another one wrote before."""
    out = np.zeros(4, np.uint32)
    run(
        "mov.u32 %r1, %tid.x; mov.u64 %rd1, room; mul.wide.u32 %rd2, %r1, 4;"
        "add.s64 %rd3, %rd1, %rd2; st.shared.u32 [%rd3], %r1; bar.sync 0;"
        "xor.b32 %r2, %r1, 3; mul.wide.u32 %rd4, %r2, 4; add.s64 %rd5, %rd1, %rd4;"
        "ld.shared.u32 %r3, [%rd5]; add.s64 %rd6, %rd0, %rd2; st.u32 [%rd6], %r3;",
        out,
        block_size=4,
        declared=".shared .align 4 .b8 room[16];",
    )
    assert out.tolist() == [3, 2, 1, 0]


def test_a_warp_votes_with_those_that_are_there():
    """Odd lanes vote on which are active, and which are above lane 8; even ones do not vote."""
    out = np.zeros((40, 3), np.uint32)
    run(
        "mov.u32 %r1, %tid.x; mul.wide.u32 %rd2, %r1, 12; add.s64 %rd3, %rd0, %rd2;"
        "and.b32 %r2, %r1, 1; setp.eq.s32 %p1, %r2, 0; @%p1 bra $END;"
        "activemask.b32 %r3; st.u32 [%rd3], %r3; setp.gt.u32 %p2, %r1, 8;"
        "vote.sync.ballot.b32 %r4, %p2, %r3; st.u32 [%rd3+4], %r4;"
        "shr.u32 %r5, %r1, 3; match.any.sync.b32 %r6, %r5, %r3; st.u32 [%rd3+8], %r6;\n$END:",
        out,
        block_size=40,
    )
    odd = 0xAAAAAAAA
    assert out[:32:2].tolist() == [[0, 0, 0]] * 16
    assert out[33].tolist() == [0xAA, 0xAA, 0xAA]
    assert out[1].tolist() == [odd, odd & ~0x1FF, 0xAA]
    assert out[31].tolist() == [odd, odd & ~0x1FF, 0xAA000000]


def test_a_vote_for_which_some_never_come_is_an_error():
    with pytest.raises(PtxError, match="others of their warp that do not come"):
        run(
            "mov.u32 %r1, %tid.x; setp.eq.s32 %p1, %r1, 0; @%p1 bra $END;"
            "vote.sync.ballot.b32 %r4, %p1, 3;\n$END:",
            0,
            block_size=2,
        )


def test_what_is_freed_is_gone(driver):
    array = driver.device_array(64, np.uint8)
    address = array.handle
    driver.memory.write(address, bytes(4))
    del array
    with pytest.raises(PtxError, match=r"behind|nothing is"):
        driver.memory.read(address, 4)
