"""The papers' kernels: the usual hits on ordinary rays, and the published words."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from extras import need

need("raystream_lab")

import raystream as rs
from meshes import dented_sphere, soup
from raystream.jit.cpu import kernel
from raystream.machines.records import INTERSECTING, TRAVERSING
from raystream.machines.steps import steps_of
from raystream.streams import Counters
from raystream_lab import published
from raystream_lab.as_published.brute_force import BruteForce
from raystream_lab.as_published.grid_kernels import grid_steps
from raystream_lab.as_published.kdtree_kernels import _node, _packed_node, _traversal, kdtree_steps
from raystream_lab.as_published.triangle import PrintedHit, intersect_triangle
from raystream_lab.foley.key_kernels import _published_kernels
from raystream_lab.kernels.costs import cost_of
from raystream_lab.kernels.snapshots import Search, local_rays

BACKTRACK = {"layout": "foley", "traversal": "backtrack"}
FORMS = {
    "grid": ({"resolution": 6}, grid_steps),
    "grid, exact": ({"resolution": 6, "overlap": "exact"}, grid_steps),
    "kdtree": (BACKTRACK, kdtree_steps),
    "kdtree, exact": ({**BACKTRACK, "overlap": "exact", "intersection_cost": 9.0}, kdtree_steps),
    "kdtree, box": ({**BACKTRACK, "overlap": "box", "empty_bonus": 0.5}, kdtree_steps),
}


def built(scene, form):
    options, make = FORMS[form]
    structure = rs.Tracer(scene, form.partition(",")[0], **options).structure
    return structure, make(structure)


@kernel
def _test(corners, origins, directions, t, hits):
    for i in range(np.uint64(len(origins))):
        o = origins[i, 0], origins[i, 1], origins[i, 2]
        d = directions[i, 0], directions[i, 1], directions[i, 2]
        a = corners[0, 0], corners[0, 1], corners[0, 2]
        b = corners[1, 0], corners[1, 1], corners[1, 2]
        c = corners[2, 0], corners[2, 1], corners[2, 2]
        h = PrintedHit(t[i], np.float32(0.0), np.float32(0.0), np.int32(-1))
        h = intersect_triangle(o, d, a, b, c, np.int32(7), h)
        hits[i, 0], hits[i, 1], hits[i, 2], hits[i, 3] = h.t, h.u, h.v, h.prim_id


def test_the_printed_test_solves_for_t_u_and_v(rng):
    corners = rng.normal(size=(3, 3)).astype(np.float32)
    origins = rng.normal(size=(2000, 3)).astype(np.float32)
    weights = rng.uniform(-0.3, 1.0, (2000, 2))
    targets = np.column_stack([1 - weights.sum(axis=1), weights]) @ corners.astype(float)
    directions = ((targets - origins) * rng.uniform(-0.5, 2, (2000, 1))).astype(np.float32)
    far = rng.uniform(0.2, 3, 2000).astype(np.float32)
    hits = np.empty((2000, 4), np.float32)
    _test(corners, origins, directions, far, hits)
    a, b, c = corners.astype(float)
    system = np.stack(
        [-directions.astype(float), np.tile(b - a, (2000, 1)), np.tile(c - a, (2000, 1))], axis=2
    )
    t, u, v = np.linalg.solve(system, (origins - a)[..., None])[..., 0].T
    expected = (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0) & (t < far)
    margin = np.min(np.abs([u, v, 1 - u - v, t, t - far]), axis=0)
    clear = margin > 1e-4
    assert np.array_equal(hits[clear, 3] == 7, expected[clear])
    hit = clear & expected
    assert hit.sum() > 200
    np.testing.assert_allclose(hits[hit, :3], np.stack([t, u, v])[:, hit].T, rtol=1e-3, atol=1e-3)
    missed = clear & ~expected
    np.testing.assert_array_equal(hits[missed, 0], far[missed])
    assert (hits[missed, 1:] == [0, 0, -1]).all()


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("mesh", ["soup", "closed", "spheres", "cornell_open"])
def test_ordinary_rays_have_the_usual_hits(form, mesh, rng):
    if mesh in ("soup", "closed"):
        vertices, faces = soup(300, 3, 0.3) if mesh == "soup" else dented_sphere(3)
        scene = rs.Scene.from_arrays(vertices, faces)
        origins, directions = rng.uniform(-2, 2, (3000, 3)), rng.normal(size=(3000, 3))
    else:
        scene = rs.load(mesh)
        origins, directions = scene.camera_for(1.0).rays(48, 48)
    structure, steps = built(scene, form)
    rays = local_rays(structure, origins, directions)
    search, usual = Search(structure, rays, steps=steps), Search(structure, rays)
    assert search.run() > 10
    usual.run()
    np.testing.assert_array_equal(search.hits.prim_id, usual.hits.prim_id)
    hit = usual.hits.prim_id >= 0
    assert hit.sum() > 200
    for name, bound in (("t", 1e-4), ("u", 1e-2), ("v", 1e-2)):
        own, other = getattr(search.hits, name)[hit], getattr(usual.hits, name)[hit]
        np.testing.assert_allclose(own, other, rtol=1e-4, atol=bound)
    assert np.isinf(search.hits.t[~hit]).all()


@pytest.mark.parametrize("scheduler", ["naive", "most-work", "double"])
def test_schedulers_change_no_hit(scheduler):
    scene = rs.load("spheres")
    for form in ("grid", "kdtree"):
        structure, steps = built(scene, form)
        rays = local_rays(structure, *scene.camera_for(1.0).rays(24, 24))
        found = []
        for chosen in ("threshold", scheduler):
            search = Search(structure, rays, chosen, compaction=True, steps=steps)
            search.run()
            found.append(search.hits.prim_id)
        np.testing.assert_array_equal(*found)


def test_edges_may_be_missed():
    """What a watertight test is for: rays from within a closed mesh, aimed at its edges."""
    rng = np.random.default_rng(5)
    vertices, faces = dented_sphere(3)
    scene = rs.Scene.from_arrays(vertices, faces)
    share = rng.random((40_000, 1))
    chosen = vertices[faces[rng.integers(0, len(faces), 40_000)]]
    targets = chosen[:, 0] * share + chosen[:, 1] * (1 - share)
    origins = rng.uniform(-0.1, 0.1, targets.shape)
    brute = rs.Tracer(scene, "brute").structure
    rays = local_rays(brute, origins, targets - origins)
    seen = rs.Tracer(scene).any_hit(origins, targets - origins)
    passes = BruteForce(brute.triangles, rays)
    assert passes.run() == len(faces)
    missed = seen & (passes.hits.array["prim_id"] < 0)
    assert seen.sum() > 30_000
    assert 0 < missed.sum() < 400


def test_brute_force_takes_a_pass_per_triangle():
    scene = rs.load("cornell_open")
    brute = rs.Tracer(scene, "brute").structure
    rays = local_rays(brute, *scene.camera_for(1.0).rays(32, 32))
    usual = Search(brute, rays)
    usual.run()
    passes = BruteForce(brute.triangles, rays)
    for _ in range(2):  # the second starts over
        counters = Counters()
        assert passes.run(counters) == len(counters.passes) == 32
        np.testing.assert_array_equal(passes.hits.array["prim_id"], usual.hits.prim_id)
        np.testing.assert_allclose(passes.hits.array["t"], usual.hits.t, rtol=1e-5)
    # Foley 2005, Table 3: 12 floats in, of which 2 are constants or the triangle's here; 4 out.
    assert counters.passes[0].words_read == {"ray": 6 * 1024, "hit": 4 * 1024}
    assert counters.passes[0].words_written == {"hit": 4 * 1024}


@kernel
def _round_trip(nodes, result):
    for i in range(len(nodes)):
        result[i] = _node(_packed_node(nodes[i]))


@given(st.lists(st.tuples(st.integers(0, 2**30 - 1), st.booleans()), min_size=1))
def test_packed_nodes_are_unpacked(drawn):
    nodes = np.array([row | (is_leaf << 31) for row, is_leaf in drawn], np.uint64)
    result = np.zeros_like(nodes)
    _round_trip(nodes, result)
    np.testing.assert_array_equal(result, nodes)


@kernel
def _signs_of(state, result):
    _, t_min, t_max = _traversal(np.uint64(3), np.float32(0.0), np.float32(2.0), state)
    result[0], result[1] = t_min, t_max


def test_sign_bits_hold_the_state():
    result = np.zeros(2, np.float32)
    _signs_of(TRAVERSING, result)
    assert np.signbit(result).tolist() == [False, False]
    _signs_of(INTERSECTING, result)
    assert np.signbit(result).tolist() == [True, False]  # of a zero, too
    assert np.abs(result).tolist() == [0.0, 2.0]


def test_records_have_the_papers_words():
    """Purcell 2002, Table 1 (W and M), and Foley 2005, Table 3 (floats out)."""
    table_1 = published("purcell", "table 1").values["multipass"]
    table_3 = published("foley", "table 3").values
    scene = rs.load("cornell")
    costs = {}
    for form in ("grid", "kdtree"):
        _, steps = built(scene, form)
        for number, one in enumerate(steps.kernels):
            costs[form, one.name] = cost_of(steps, number)
    step, test = costs["grid", "traverse"], costs["grid", "intersect"]
    assert step.used_out == table_1["step"]["written"]
    assert test.used_out == table_1["intersect"]["written"]
    assert test.fetched_words == table_1["intersect"]["memory"]
    assert test.used_in <= table_1["intersect"]["read"]
    for name in ("down", "up"):
        assert costs["kdtree", name].used_out == table_3[f"kd {name}"]["floats_out"]
    assert costs["kdtree", "intersect"].used_out <= table_3["kd intersect"]["floats_out"]


def test_table_3_has_all_of_the_papers_kernels():
    found = _published_kernels()
    theirs = published("foley", "table 3").values
    assert set(found) == set(theirs)
    # Between the paper's vector instructions and what our kernels take.
    for name, one in found.items():
        assert theirs[name]["instructions"] < one["instructions"] < 200
        assert one["floats_in"] <= theirs[name]["floats_in"]


@pytest.mark.parametrize("form", ["grid", "kdtree"])
def test_printed_tests_are_shorter_than_ours(form):
    structure, steps = built(rs.load("cornell"), form)
    names = [one.name for one in steps.kernels]
    number = names.index("intersect")
    own = steps_of(structure)
    ours = cost_of(own, [one.name for one in own.kernels].index("intersect"))
    assert 3 * cost_of(steps, number).code.total < 2 * ours.code.total


def test_other_structures_are_refused():
    scene = rs.load("cornell")
    with pytest.raises(ValueError, match="levels: expected 1, got 2"):
        grid_steps(rs.Tracer(scene, "grid", levels=2).structure)
    with pytest.raises(ValueError, match="expected layout 'foley' and traversal 'backtrack'"):
        kdtree_steps(rs.Tracer(scene, "kdtree").structure)


@pytest.mark.parametrize("form", ["grid", "kdtree"])
def test_an_empty_scene_has_no_hits(form):
    scene = rs.Scene.from_arrays(np.zeros((3, 3)), [[0, 1, 2]])
    structure, steps = built(scene, form)
    search = Search(
        structure, local_rays(structure, np.zeros((5, 3)), np.ones((5, 3))), steps=steps
    )
    search.run()
    assert (search.hits.prim_id == -1).all()
