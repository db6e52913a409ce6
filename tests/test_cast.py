"""One ray from numbers to numbers: `Tracer.cast` has the bits of `first_hit`."""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs
from cases import CASES
from conftest import EVERY_QUERY
from meshes import grid_floor, soup
from strategies import scenes_and_rays

#: Numbers that float32 cannot represent, or that have signs, exponents and payloads of their own.
AWKWARD = st.one_of(
    st.floats(width=64),
    st.floats(width=32),
    st.sampled_from([0.0, -0.0, np.inf, -np.inf, np.nan, 5e-324, 1e-45, 2.0**199, 2.0**201, 1e300]),
)


def assert_same_as_first_hit(tracer, origin, direction, t_min=0.0, t_max=np.inf):
    """Bits, status and types; returns the hit."""
    hit = tracer.cast(origin, direction, t_min, t_max)
    hits = tracer.first_hit(origin, direction, t_min=t_min, t_max=t_max)
    assert [type(one) for one in hit] == [float, float, float, int]
    assert [one.hex() for one in hit[:3]] == [one.item().hex() for one in (hits.t, hits.u, hits.v)]
    assert hit.prim_id == hits.prim_id
    assert hit.status == hits.status
    assert isinstance(hit.status, rs.RayStatus)
    assert bool(hit) == bool(hits.is_hit)
    return hit


@pytest.mark.parametrize("make_tracer", EVERY_QUERY, indirect=True)
@pytest.mark.parametrize(
    "name", ["edges_and_vertices_from_outside", "origins_far_away", "limits_at_the_hits_themselves"]
)
def test_the_bits_of_first_hit(make_tracer, name):
    case = CASES[name](np.random.default_rng(26))
    tracer = make_tracer(case.scene)
    t_min, t_max = case.limits()
    rays = zip(case.origins, case.directions, t_min.tolist(), t_max.tolist(), strict=True)
    hits = [assert_same_as_first_hit(tracer, *ray) for ray in list(rays)[:60]]
    assert any(hits)


@settings(max_examples=60)
@given(scenes_and_rays(max_rays=3), st.lists(AWKWARD, min_size=2, max_size=2), st.data())
def test_awkward_rays_and_limits(drawn, limits, data):
    vertices, faces, origins, directions = drawn
    tracers = [
        rs.Tracer(rs.Scene.from_arrays(vertices, faces), name)
        for name in ("bvh", "brute", "grid", "kdtree", "graph")
    ]
    rays = list(zip(origins.tolist(), directions.tolist(), strict=True))
    three = st.lists(AWKWARD, min_size=3, max_size=3)
    rays.append((data.draw(three), data.draw(three)))
    for origin, direction in rays:
        found = []
        for tracer in tracers:
            found.append(assert_same_as_first_hit(tracer, origin, direction))
            assert_same_as_first_hit(tracer, origin, direction, *limits)
        assert len(set(found)) == 1


@pytest.mark.parametrize(
    "convert",
    [
        tuple,
        list,
        lambda three: [round(one) for one in three],
        lambda three: tuple(np.float32(three)),
        lambda three: [three[0], int(three[1]), np.float64(three[2])],
        *(lambda three, dtype=dtype: np.array(three, dtype) for dtype in ("f2", "f4", "f8", ">f4")),
        lambda three: np.array(three, np.longdouble),
        lambda three: np.array(three, np.int16),
        lambda three: np.array([three, three]).T[:, 0],
        lambda three: memoryview(np.array(three)),
    ],
)
def test_any_three_real_numbers(convert):
    tracer = rs.Tracer(rs.Scene.from_arrays(*grid_floor(4)))
    origin, direction = convert([0.25, 5.0, 0.5]), convert([0.0, -1.0, 0.0])
    assert assert_same_as_first_hit(tracer, origin, direction)
    assert assert_same_as_first_hit(tracer, origin, direction, np.float32(0.5), 100)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"origin": (0.0, 0.0)}, ValueError, r"origin: expected shape \(3,\), got \(2,\)"),
        ({"origin": 1.0}, ValueError, r"origin: expected shape \(3,\), got \(\)"),
        ({"direction": [[0.0, 0.0, 1.0]]}, ValueError, r"direction: expected shape \(3,\)"),
        ({"direction": (0.0, 0.0, 1j)}, TypeError, "direction: expected real numbers"),
        ({"direction": "abc"}, TypeError, "direction: expected real numbers"),
        ({"origin": ("1", "2", "3")}, TypeError, "origin: expected real numbers"),
        ({"origin": (0, 0, 10**400)}, TypeError, "origin: expected real numbers"),
        ({"origin": (True, True, True)}, TypeError, "origin: expected real numbers"),
        ({"t_min": [0.0]}, ValueError, r"t_min: expected one number, got shape \(1,\)"),
        ({"t_max": None}, TypeError, "t_max: expected real numbers"),
        ({"t_max": 10**400}, TypeError, "t_max: expected real numbers"),
    ],
)
@pytest.mark.parametrize("options", [{}, {"counters": True}])
def test_errors(change, error, message, options):
    tracer = rs.Tracer(rs.load("cornell"), **options)
    with pytest.raises(error, match=message):
        tracer.cast(**{"origin": (0.0, 0.0, 0.0), "direction": (0.0, 0.0, 1.0), **change})


@pytest.mark.parametrize("structure", ["bvh", "brute", "grid", "kdtree", "graph"])
def test_empty_scenes(structure):
    tracer = rs.Tracer(rs.Scene.from_arrays(np.empty((0, 3)), np.empty((0, 3), int)), structure)
    hit = assert_same_as_first_hit(tracer, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    assert not hit
    assert hit == (np.inf, 0.0, 0.0, -1)


def test_a_hit_is_a_tuple_that_knows_its_triangle():
    tracer = rs.Tracer(rs.load("cornell"))
    ray = (278.0, 273.0, -800.0), (0.0, 0.0, 1.0)
    hit, hits = tracer.cast(*ray), tracer.first_hit(*ray)
    t, _, _, prim_id = hit
    assert (t, prim_id) == (hit.t, hit.prim_id)
    assert repr(hit).startswith("RayHit(t=1091.9")
    assert (hit.position == hits.positions).all()
    assert (hit.normal == hits.normals).all()
    assert hit.hits.mesh_id == hits.mesh_id
    again = tracer.cast(*hit.hits.spawn([0.0, 0.0, -1.0]))
    assert again.prim_id != hit.prim_id
    restored = pickle.loads(pickle.dumps(hit))
    assert restored == hit
    assert (restored.normal == hit.normal).all()
    miss = tracer.cast(ray[0], (0.0, 0.0, -1.0))
    assert not miss
    assert np.isnan(miss.position).all()
    invalid = tracer.cast(ray[0], (0.0, 0.0, 0.0))
    assert not invalid
    assert invalid.status is rs.RayStatus.INVALID


@pytest.mark.parametrize("structure", ["bvh", "brute", "grid", "kdtree", "graph"])
@pytest.mark.parametrize("limit", [0.0, 1e9])
def test_updated_tracers_cast_at_the_moved_triangles(structure, limit):
    vertices, faces = grid_floor(4)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces), structure)
    eye, down = (0.3, 7.0, 0.4), (0.0, -1.0, 0.0)
    before = tracer.cast(eye, down)
    for shift in (1.0, 2.5, -3.0):
        tracer.update(vertices + [0.0, shift, 0.0], max_cost_growth=limit)
        after = assert_same_as_first_hit(tracer, eye, down)
        assert after.t == pytest.approx(before.t - shift, rel=1e-6)
        assert after.position[1] == pytest.approx(before.position[1] + shift, abs=1e-5)


def test_updated_scenes_of_other_materials_are_cast_at_too():
    tracer = rs.Tracer(rs.load("cornell"))
    tracer.update(tracer.scene)
    assert_same_as_first_hit(tracer, (278, 273, -800), (0, 0, 1))


@pytest.mark.parametrize("structure", ["bvh", "brute", "grid", "kdtree", "graph"])
def test_loaded_tracers(structure, tmp_path):
    rs.Tracer(rs.load("cornell"), structure).save(tmp_path / "a.npz")
    tracer = rs.Tracer.load(tmp_path / "a.npz")
    assert assert_same_as_first_hit(tracer, (278, 273, -800), (0, 0, 1)).prim_id == 30


@pytest.mark.parametrize("structure", ["bvh", "brute", "grid", "kdtree", "graph"])
def test_copied_tracers_read_their_own_arrays(structure):
    """Addresses are of the copy's arrays, not of the original's, which may be gone."""
    tracer = rs.Tracer(rs.load("cornell"), structure)
    for other in (copy.deepcopy(tracer), pickle.loads(pickle.dumps(tracer))):
        own = [one.ctypes.data for one in other.structure.arrays.values() if one.size]
        theirs = [one.ctypes.data for one in tracer.structure.arrays.values() if one.size]
        numbers = {int(one) for one in other.structure.view if isinstance(one, np.uint64)}
        assert not numbers & set(theirs)
        assert numbers & set(own)
        assert assert_same_as_first_hit(other, (278, 273, -800), (0, 0, 1)).prim_id == 30
        assert other.structure.options == tracer.structure.options


@pytest.mark.ci
def test_pickled_tracers_trace_in_another_process(tmp_path):
    tracer = rs.Tracer(rs.load("cornell"), kernel="wavefront")
    (tmp_path / "tracer").write_bytes(pickle.dumps(tracer))
    code = (
        "import pickle, sys; tracer = pickle.load(open(sys.argv[1], 'rb'));"
        "print(tracer.cast((278, 273, -800), (0, 0, 1)).prim_id,"
        " tracer.first_hit([278, 273, -800], [0, 0, 1]).prim_id, tracer.structure.options.kernel,"
        " tracer.scene.meshes[0].name)"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "tracer")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=True)
    assert done.stdout.split()[:3] == ["30", "30", "wavefront"]
    assert done.stdout.split(maxsplit=3)[3].strip() == tracer.scene.meshes[0].name


def test_threads_cast_at_the_same_time(rng):
    tracer = rs.Tracer(rs.Scene.from_arrays(*soup(500)))
    origins, directions = rng.normal(size=(2, 4000, 3))
    hits = tracer.first_hit(origins, directions)
    expected = list(zip(hits.t.tolist(), hits.prim_id.tolist(), strict=True))
    rays = list(zip(origins.tolist(), directions.tolist(), strict=True))

    def cast_all(step):  # in this order, or from the last to the first
        found = [tracer.cast(*ray) for ray in rays[::step]]
        return [(one.t, one.prim_id) for one in found[::step]]

    with ThreadPoolExecutor(8) as pool:
        results = list(pool.map(cast_all, [1, -1] * 4))
    assert results == [expected] * 8


def test_counting_tracers_count_the_ray():
    tracer = rs.Tracer(rs.load("cornell"), counters=True)
    assert_same_as_first_hit(tracer, (278, 273, -800), (0, 0, 1))
    tracer.cast((278, 273, -800), (0, 0, 1))
    assert tracer.counters.steps.sum() > 0


def test_a_first_hit_of_a_subclass_is_used():
    class Shifted(rs.Tracer):
        def first_hit(self, *rays, **options):
            hits = super().first_hit(*rays, **options)
            hits.t += 1.0
            return hits

    scene, ray = rs.load("cornell"), ((278, 273, -800), (0, 0, 1))
    assert Shifted(scene).cast(*ray).t == pytest.approx(rs.Tracer(scene).cast(*ray).t + 1.0)
