"""Rays in device arrays, read and answered without copies; and host arrays in parts."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from extras import need

need("numba_cuda")

import raystream as rs
from conftest import assert_same_bits
from raystream.cuda.device_hits import DeviceHits, DeviceMultiHits
from raystream.cuda.scan import prefix_sum
from raystream.jit.cuda import (
    CudaError,
    CudaStream,
    DeviceArray,
    Gpu,
    RangeKernel,
    StreamScope,
    is_simulated,
)
from test_agreement import case_of

#: A simulated thread takes a tenth of a millisecond.
RAYS = 24

COLUMNS = ("t", "u", "v", "prim_id", "status")

#: DLPack's name of a GPU's memory.
KIND = 2


def placed(gpu: Gpu, array: np.ndarray) -> tuple[DeviceArray, int]:
    """The memory that an array is a view of, on the device, and where the array begins in it."""
    owner = array
    while isinstance(owner.base, np.ndarray):
        owner = owner.base
    made = gpu.upload("test", np.ascontiguousarray(owner))
    return made, int(made.address) + array.ctypes.data - owner.ctypes.data


class CudaArray:
    """The interface of CuPy and Numba: ``__cuda_array_interface__``."""

    def __init__(self, gpu: Gpu, array: np.ndarray, **changes: Any) -> None:
        array = np.asarray(array)
        self._memory, self.address = placed(gpu, array)
        self.__cuda_array_interface__ = {
            "shape": array.shape,
            "typestr": array.dtype.str,
            "data": (self.address, True),
            "strides": None if array.flags.c_contiguous else array.strides,
            "version": 3,
            **changes,
        }


@dataclass
class Exporter:
    """The interface of PyTorch and JAX: DLPack."""

    gpu: Gpu
    array: np.ndarray
    number: int = 0
    streams: list[Any] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.array = np.asarray(self.array)
        self._memory, self.address = placed(self.gpu, self.array)

    def __dlpack_device__(self) -> tuple[int, int]:
        return KIND, self.number

    def __dlpack__(self, *, stream: Any = None, max_version: Any = None) -> Any:
        """NumPy's capsule, relabelled as device memory."""
        self.streams.append(stream)
        capsule = self.array.__dlpack__()
        find = ctypes.pythonapi.PyCapsule_GetPointer
        find.restype, find.argtypes = ctypes.c_void_p, (ctypes.py_object, ctypes.c_char_p)
        tensor = find(capsule, b"dltensor")
        ctypes.c_uint64.from_address(tensor).value = self.address
        ctypes.c_int32.from_address(tensor + 8).value = KIND
        return capsule


@pytest.fixture(scope="module")
def case():
    return case_of("random_soup")


@pytest.fixture
def rays(case):
    rows = np.linspace(0, len(case.origins) - 1, RAYS).astype(int)
    return case.origins[rows].astype(np.float32), case.directions[rows].astype(np.float32)


@pytest.fixture
def tracer(gpu, case):
    return rs.Tracer(case.scene, "brute", "cuda")


@pytest.fixture
def oracle(case):
    return rs.Tracer(case.scene, "brute")


def spread(array: np.ndarray) -> np.ndarray:
    """The same numbers with gaps between the rows."""
    wide = np.full((len(array), 5), np.nan, array.dtype)
    wide[:, 1:4] = array
    return wide[:, 1:4]


def columns_of(array: np.ndarray) -> np.ndarray:
    """The same numbers, in columns."""
    return np.ascontiguousarray(array.T).T


def layouts(origins: np.ndarray, directions: np.ndarray) -> Iterator[tuple[str, tuple[Any, ...]]]:
    """Names and arrays, the arrays to be placed: those first that are not to be copied."""
    limits = np.linspace(0.5, 3.0, RAYS)
    yield "packed", (origins, directions, np.inf)
    yield "double", (origins.astype(float), directions.astype(float), 2.0)
    yield "gaps", (spread(origins), spread(directions), limits.astype(np.float32))
    yield (
        "backward",
        (origins[::-1], directions[::-2].repeat(2, 0)[::-1], limits.astype("f4")[::-1]),
    )
    yield "one origin", (origins[0], directions, np.float32([1.5]))
    yield (
        "one direction",
        (origins.reshape(4, 6, 3), directions[:1], limits.astype("f4").reshape(4, 6)),
    )
    yield "one of all", (np.broadcast_to(origins[3], (4, 6, 3)), directions[5], 3)
    yield "one ray", (origins[0], directions[0], np.inf)
    yield "no ray", (origins[:0], directions[:0], np.inf)


def awkward(origins: np.ndarray, directions: np.ndarray) -> Iterator[tuple[str, tuple[Any, ...]]]:
    """Those that are packed on the device."""
    limits = np.linspace(0.5, 3.0, RAYS)
    yield "crossed", (origins[:4, None], directions[:6], np.inf)
    yield "columns", (columns_of(origins), directions, np.inf)
    yield "double limits", (origins, directions, limits)
    yield (
        "crossed limits",
        (
            origins.reshape(4, 6, 3).astype(float).swapaxes(0, 1),
            directions.reshape(6, 4, 3),
            limits[::-4].astype("f4")[:, None],
        ),
    )


def given(gpu: Gpu, arrays: tuple[Any, ...], kind: type) -> list[Any]:
    """Arrays on the device; scalars are returned unchanged."""
    return [kind(gpu, one) if isinstance(one, np.ndarray) else one for one in arrays]


def assert_same(ours: Any, theirs: Any, *names: str) -> None:
    for name in names:
        assert_same_bits(getattr(ours, name), getattr(theirs, name))


@pytest.fixture
def launches(monkeypatch):
    """Arguments of the kernels that are launched, by name."""
    seen: list[tuple[str, tuple[Any, ...]]] = []
    launch = RangeKernel.launch

    def noting(self, gpu, count, arguments, stream=None):
        seen.append((self.name, arguments))
        launch(self, gpu, count, arguments, stream)

    monkeypatch.setattr(RangeKernel, "launch", noting)
    return seen


def test_rays_are_read_where_they_are(gpu, tracer, oracle, rays, launches):
    for name, arrays in layouts(*rays):
        launches.clear()
        kind = Exporter if name in ("packed", "gaps") else CudaArray
        there = given(gpu, arrays, kind)
        hits = tracer.first_hit(there[0], there[1], t_max=there[2])
        assert isinstance(hits, DeviceHits)
        expected = oracle.first_hit(arrays[0], arrays[1], t_max=arrays[2])
        assert_same(hits.host(), expected, *COLUMNS, "material_id", "shading_normals")
        ((query, (scene, _)),) = launches
        source = scene.source
        assert query == "first_hit", name  # and no kernel that packs
        if np.size(arrays[0]):
            assert source.origins == there[0].address, name
            assert source.directions == there[1].address, name
    assert source.origin_step in (0, 12)


def test_other_layouts_are_packed_on_the_device(gpu, tracer, oracle, rays, launches):
    for name, arrays in awkward(*rays):
        launches.clear()
        there = given(gpu, arrays, CudaArray)
        hits = tracer.first_hit(there[0], there[1], t_max=there[2])
        expected = oracle.first_hit(arrays[0], arrays[1], t_max=arrays[2])
        assert_same(hits.host(), expected, *COLUMNS)
        assert [query for query, _ in launches][-2:] == ["pack_row", "first_hit"], name


def test_all_queries_have_brute_forces_bits(gpu, case, oracle, rays):
    there = given(gpu, rays, CudaArray)
    for structure in ("brute", "bvh"):
        tracer = rs.Tracer(case.scene, structure, "cuda")
        seen = tracer.any_hit(*there)
        assert_same_bits(seen.host(), oracle.any_hit(*rays))
        for crossings in ("triangles", "surfaces"):
            counts = tracer.count_hits(*there, crossings=crossings)
            assert_same_bits(counts.host(), oracle.count_hits(*rays, crossings=crossings))
        for most in (None, 2, 0):
            many = tracer.multi_hit(*there, max_hits=most)
            assert isinstance(many, DeviceMultiHits)
            expected = oracle.multi_hit(*rays, max_hits=most)
            assert_same(many.host(), expected, "ray_splits", *COLUMNS)


@pytest.mark.parametrize("structure", ["bvh", "brute"])
def test_float64_has_the_cpus_bits(gpu, case, rays, structure, launches):
    oracle = rs.Tracer(case.scene, "brute", precision="float64")
    tracer = rs.Tracer(case.scene, structure, "cuda", precision="float64")
    for name, arrays in (*layouts(*rays), *awkward(*rays)):
        there = given(gpu, arrays, CudaArray)
        hits = tracer.first_hit(there[0], there[1], t_max=there[2])
        expected = oracle.first_hit(arrays[0], arrays[1], t_max=arrays[2])
        assert hits.t.dtype == hits.u.dtype == hits.v.dtype == np.float64
        assert_same(hits.host(), expected, *COLUMNS, "normals")
        # Limits in float64 are read where they are; those in float32 are packed.
        is_packed = name in ("crossed", "columns", "crossed limits")
        is_packed |= getattr(arrays[2], "dtype", None) == np.float32
        assert ("pack_row" in [query for query, _ in launches]) == is_packed, name
        launches.clear()
    there = given(gpu, rays, CudaArray)
    hits = tracer.first_hit(*there)
    limits = {"t_max": hits.t}, {"t_max": hits.t.host()}
    seen, counts = tracer.any_hit(*there, **limits[0]), tracer.count_hits(*there, **limits[0])
    assert_same_bits(seen.host(), oracle.any_hit(*rays, **limits[1]))
    assert_same_bits(counts.host(), oracle.count_hits(*rays, **limits[1]))
    for options in ({"crossings": "surfaces"}, {"max_hits": 2}, {"max_hits": 0}):
        many, expected = (
            one.multi_hit(*a, **options) for one, a in ((tracer, there), (oracle, rays))
        )
        assert_same(many.host(), expected, "ray_splits", *COLUMNS)
        assert type(many.host()) is type(expected)


class Cupy(CudaArray):
    """An array by whose type its library is known."""

    shape = (RAYS, 3)


Cupy.__module__ = "cupy"


def test_results_are_in_the_library_of_the_rays(gpu, tracer, oracle, rays, monkeypatch):
    library = ModuleType("cupy")
    library.from_dlpack = lambda array: ("viewed", array)
    monkeypatch.setitem(sys.modules, "cupy", library)
    there = given(gpu, rays, Cupy)
    hits, many = tracer.first_hit(*there), tracer.multi_hit(*there)
    for found, name in ((hits, "t"), (hits, "status"), (many, "prim_id"), (many, "ray_splits")):
        viewed, array = getattr(found, name)
        assert viewed == "viewed"
        assert isinstance(array, DeviceArray)
        assert_same_bits(array.host(), getattr(found.host(), name))
    assert_same(hits.host(), oracle.first_hit(*rays), *COLUMNS)
    assert_same(many.host(), oracle.multi_hit(*rays), "ray_splits", *COLUMNS)
    for found in (tracer.any_hit(*there), tracer.count_hits(*there)):
        assert found[0] == "viewed"
    with pytest.raises(AttributeError, match=r"positions: not available on a GPU; see host\(\)"):
        _ = hits.positions


def test_invalid_rays_have_a_status(gpu, tracer, rays):
    origins, directions = rays
    origins[0, 1], directions[1] = np.nan, 0.0
    there = given(gpu, (origins, directions), CudaArray)
    for most in (None, 0):
        status = tracer.multi_hit(*there, max_hits=most).status.host()
        assert status.tolist() == [1, 1, *[0] * (RAYS - 2)]
    assert tracer.first_hit(*there).status.host().tolist() == [1, 1, *[0] * (RAYS - 2)]


def test_answers_are_handed_on_without_a_copy(gpu, tracer, oracle, rays):
    from cuda.core.utils import StridedMemoryView

    there = given(gpu, tuple(one.reshape(4, 6, 3) for one in rays), CudaArray)
    hits = tracer.first_hit(*there)
    for column in (*(getattr(hits, name) for name in COLUMNS), tracer.any_hit(*there)):
        interface = column.__cuda_array_interface__
        view = StridedMemoryView.from_dlpack(column, stream_ptr=-1)
        assert interface["shape"] == tuple(view.shape) == (4, 6)
        assert np.dtype(interface["typestr"]) == view.dtype == column.dtype
        assert interface["data"][0] == view.ptr == int(column.address)
        assert interface["version"] == 3
    # They are ray limits of the next query, and stay alive while they are viewed.
    view, t = StridedMemoryView.from_dlpack(hits.t, stream_ptr=-1), hits.t.host()
    seen = tracer.any_hit(*there, t_max=hits.t).host()
    assert_same_bits(seen, oracle.any_hit(rays[0], rays[1], t_max=t.ravel()).reshape(4, 6))
    del hits
    tracer.first_hit(*there)
    if is_simulated():
        assert_same_bits(np.from_dlpack(view).copy(), t)


def test_columns_are_copied_or_sent_elsewhere_by_nobody(gpu, tracer, rays):
    t = tracer.first_hit(*given(gpu, rays, CudaArray)).t
    with pytest.raises(BufferError, match="copies are not supported"):
        t.__dlpack__(copy=True)
    with pytest.raises(BufferError, match="is on device"):
        t.__dlpack__(dl_device=(KIND, 77))


@pytest.fixture
def waits(monkeypatch):
    """Pairs of handles: a stream, and the one that it was made to wait for."""
    if not is_simulated():
        pytest.skip("streams of these handles exist in the simulator")
    seen: list[tuple[int, int]] = []

    def wait(self, other):
        if self.handle != other.handle:
            seen.append((self.handle, other.handle))

    monkeypatch.setattr(CudaStream, "wait", wait)
    return seen


def test_work_is_done_in_the_callers_stream(gpu, tracer, rays, waits):
    own = gpu.stream.handle
    origins = Exporter(gpu, rays[0])
    directions = CudaArray(gpu, rays[1], stream=7)
    limits = CudaArray(gpu, np.ones(RAYS, np.float32), stream=9)
    tracer.first_hit(origins, directions, t_max=limits)
    assert origins.streams == [7]  # the exporter lets it wait
    assert waits.count((7, 9)) == 1  # for the limits
    assert (7, own) in waits  # for memory
    assert waits[-2:] == [(own, 7), (9, 7)]  # later work on these streams finds the answers


def test_the_default_stream_is_used_where_none_is_named(gpu, tracer, rays, waits):
    """Version 2 of the interface has no stream; version 3 may say that none matters."""
    origins = CudaArray(gpu, rays[0], version=2)
    directions = Exporter(gpu, rays[1])
    tracer.first_hit(origins, directions, t_max=CudaArray(gpu, np.float32(2), stream=None))
    assert directions.streams == [1]
    assert waits == []  # for the device's own is the default one in the simulator


def test_an_exception_lets_streams_follow(gpu, tracer, rays, waits):
    origins, directions = CudaArray(gpu, rays[0], stream=7), CudaArray(gpu, rays[1][:, :2])
    with pytest.raises(ValueError, match="directions: expected shape"):
        tracer.first_hit(origins, directions)
    assert waits == [(gpu.stream.handle, 7)]


def test_nobody_waits_for_first_and_any_hit(gpu, tracer, rays, monkeypatch):
    there = given(gpu, rays, CudaArray)
    done: list[Any] = []

    def wait(self, stream=None):
        raise AssertionError("the host waited")

    with monkeypatch.context() as patched:
        patched.setattr(Gpu, "wait", wait)
        done += [tracer.first_hit(*there), tracer.any_hit(*there), tracer.count_hits(*there)]
        # On a GPU, failures while it is waited for become CudaError.
        with pytest.raises((AssertionError, CudaError), match="waited"):
            tracer.multi_hit(*there)
    assert (done[0].host().prim_id >= 0).tolist() == done[1].host().tolist()


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        (lambda o: o.astype(int), TypeError, "origins: expected float32 or float64 .* int64"),
        (lambda o: o.astype(np.float16), TypeError, "origins: expected float32 or float64"),
        (lambda o: o[:, :2], ValueError, r"origins: expected shape \(..., 3\), got \(24, 2\)"),
        (lambda o: o[0, 0], ValueError, "origins: expected shape"),
        (lambda o: o[:5], ValueError, "origins and directions: .* do not broadcast"),
        (lambda o: spread(o).base.ravel().view("u1")[6:-14].view("f4")[:3], TypeError, "aligned"),
    ],
)
def test_bad_arrays_are_named(gpu, tracer, rays, change, error, words):
    for kind in (CudaArray, Exporter):
        with pytest.raises(error, match=words):
            tracer.first_hit(kind(gpu, change(rays[0])), CudaArray(gpu, rays[1]))


def test_bad_limits_are_named(gpu, tracer, rays):
    there = given(gpu, rays, CudaArray)
    with pytest.raises(ValueError, match=r"t_max: shape .* does not broadcast to the rays' shape"):
        tracer.any_hit(*there, t_max=CudaArray(gpu, np.ones(5, np.float32)))
    with pytest.raises(TypeError, match="t_min: expected real"):
        tracer.any_hit(*there, t_min="near")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"mask": object()}, "directions: cannot be read .*mask"),
        ({"strides": (4,)}, "directions: cannot be read .*strides"),
        ({"typestr": "what"}, "directions: cannot be read"),
        ({"data": None}, "directions: cannot be read"),
        ({"strides": (12, 2)}, "directions: .*aligned"),
    ],
)
def test_bad_interfaces_are_refused(gpu, tracer, rays, changes, words):
    with pytest.raises(TypeError, match=words):
        tracer.first_hit(CudaArray(gpu, rays[0]), CudaArray(gpu, rays[1], **changes))


def test_an_exporters_error_is_told(gpu, tracer, rays):
    class Refusing(Exporter):
        def __dlpack__(self, **options):
            raise BufferError("requires grad, use detach()")

    with pytest.raises(TypeError, match=r"origins: .*use detach\(\)"):
        tracer.first_hit(Refusing(gpu, rays[0]), Exporter(gpu, rays[1]))


def test_arrays_are_on_the_tracers_device(gpu, tracer, oracle, rays):
    origins = CudaArray(gpu, rays[0])
    with pytest.raises(CudaError, match=r"directions: .*GPU 3.*gpu=3"):
        tracer.first_hit(origins, Exporter(gpu, rays[1], number=3))
    with pytest.raises(TypeError, match="directions: the array is on the host"):
        tracer.first_hit(origins, rays[1])
    with pytest.raises(TypeError, match="origins: the array is on a GPU"):
        oracle.first_hit(origins, rays[1])


def test_counters_are_for_the_host(gpu, case, rays):
    there = given(gpu, rays, CudaArray)
    with pytest.raises(TypeError, match=r"on a GPU.*without counters"):
        rs.Tracer(case.scene, "brute", "cuda", counters=True).any_hit(*there)


@pytest.mark.parametrize("length", [0, 1, 1024, 1025, 65539])
def test_sums_run_over_any_length(gpu, rng, length):
    counts = rng.integers(0, 1 << 40, length)
    with StreamScope(gpu, gpu.stream) as work:
        there = work.placed("counts", counts)
        splits = prefix_sum(work, there)
    assert splits.host().tolist() == [0, *np.cumsum(counts)]
