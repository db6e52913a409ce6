"""Copies and pickles of tracers, hits and scenes, of any size and after updates."""

import copy
import gc
import pickle

import numpy as np
import pytest

import raystream as rs
from conftest import tier
from meshes import soup
from raystream.scene.geometry import _FEW

STRUCTURES = ["bvh", "brute", "grid", "kdtree", "graph"]


@pytest.fixture
def rays(rng):
    return rng.normal(size=(2, 200, 3))


class Named(rs.Tracer):
    """A tracer with an attribute of its own."""

    def __init__(self, scene, extra):
        super().__init__(scene)
        self.extra = extra


def pickled(one):
    return pickle.loads(pickle.dumps(one))


def assert_same_hits(one, other):
    assert (one.prim_id >= 0).any()
    for name in ("t", "u", "v", "prim_id"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


@pytest.mark.ci
def test_large_scenes_hits_and_tracers_are_pickled(rays):
    """Their triangles are made on all threads, and can be made again."""
    scene = rs.Scene.from_arrays(*soup(_FEW + 1))
    tracer = rs.Tracer(scene)
    hits = tracer.first_hit(*rays)
    assert_same_hits(hits, rs.Tracer(pickled(scene)).first_hit(*rays))
    for copied in (pickled, copy.deepcopy, copy.copy):
        assert_same_hits(hits, copied(tracer).first_hit(*rays))
        np.testing.assert_array_equal(copied(hits).positions, hits.positions)
        cast = tracer.cast(*(one[hits.prim_id.argmax()] for one in rays))
        assert cast
        assert copied(cast) == cast


def test_restored_corners_of_pickles_are_the_same():
    triangles = rs.Scene.from_arrays(*soup(_FEW + 1)).triangles
    corners = triangles.corners
    other = pickled(triangles)
    other.release()
    np.testing.assert_array_equal(other.corners, corners)


@pytest.mark.ci
@pytest.mark.parametrize("structure", STRUCTURES)
def test_updated_tracers_are_pickled(structure, rays):
    vertices, faces = soup(500)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces), structure)
    tracer.update(vertices + 0.125)
    hits = tracer.first_hit(*rays)
    for copied in (pickled, copy.deepcopy, copy.copy):
        assert_same_hits(hits, copied(tracer).first_hit(*rays))


@pytest.mark.parametrize(
    "structure", [pytest.param(one, marks=tier(is_everyday=one == "bvh")) for one in STRUCTURES]
)
def test_updates_of_copies_leave_the_original_alone(structure, rays):
    vertices, faces = soup(500)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces), structure)
    hits = tracer.first_hit(*rays)
    other = copy.copy(tracer)
    assert other.structure is not tracer.structure
    assert other.scene is tracer.scene
    other.update(vertices + [0.0, 0.0, 50.0], max_cost_growth=np.inf)
    assert_same_hits(hits, tracer.first_hit(*rays))
    assert other.scene is not tracer.scene


@pytest.mark.parametrize(
    "structure", [pytest.param(one, marks=tier(is_everyday=one == "bvh")) for one in STRUCTURES]
)
@pytest.mark.parametrize("moves_first", [True, False])
def test_updates_leave_other_tracers_of_the_structure_alone(structure, moves_first, rays):
    vertices, faces = soup(500)
    first = rs.Tracer(rs.Scene.from_arrays(vertices, faces), structure)
    second = rs.Tracer.of_structure(first.structure, first.scene)
    hits = first.first_hit(*rays)
    mover, other = (first, second) if moves_first else (second, first)
    for offset in (5.0, 8.0, 1e5):
        moved = vertices + [0.0, 0.0, offset]
        mover.update(moved, max_cost_growth=np.inf)
        origins = rays[0] + [0.0, 0.0, offset]
        fresh = rs.Tracer(rs.Scene.from_arrays(moved, faces), structure)
        expected = fresh.first_hit(origins, rays[1])
        assert_same_hits(mover.first_hit(origins, rays[1]), expected)
        assert_same_hits(hits, other.first_hit(*rays))
        np.testing.assert_array_equal(other.first_hit(*rays).positions, hits.positions)
    np.testing.assert_array_equal(other.scene.meshes[0].vertices, vertices)
    np.testing.assert_array_equal(mover.scene.meshes[0].vertices, moved)


def test_a_structure_is_refitted_once_it_has_one_tracer(rays):
    vertices, faces = soup(500)
    tracers = [rs.Tracer(rs.Scene.from_arrays(vertices, faces))]
    tracers += [rs.Tracer.of_structure(tracers[0].structure, counters=bool(k)) for k in range(2)]
    rebuilt = [one.update(vertices + 0.125, max_cost_growth=np.inf).rebuilt for one in tracers]
    assert rebuilt == [True, True, False]
    for one in tracers:
        assert not one.update(vertices + 0.25, max_cost_growth=np.inf).rebuilt
        assert_same_hits(one.first_hit(*rays), tracers[0].first_hit(*rays))
    other = rs.Tracer.of_structure(tracers[0].structure)
    del other
    gc.collect()
    assert not tracers[0].update(vertices, max_cost_growth=np.inf).rebuilt


def test_a_structure_whose_triangles_have_moved_is_refused():
    vertices, faces = soup(50)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces))
    before = tracer.structure
    assert not tracer.update(vertices + 0.125, max_cost_growth=np.inf).rebuilt
    with pytest.raises(ValueError, match=r"structure: Tracer.update has moved its triangles"):
        rs.Tracer.of_structure(before)
    before = tracer.structure
    assert tracer.update(vertices, max_cost_growth=0.0).rebuilt  # another tree: this one is whole
    assert rs.Tracer.of_structure(before).structure is before


def test_attributes_of_subclasses_and_users_are_copied():
    tracer = Named(rs.Scene.from_arrays(*soup(50)), extra=3)
    tracer.note = ["mine"]
    for copied in (pickled, copy.deepcopy, copy.copy):
        other = copied(tracer)
        assert type(other) is Named
        assert (other.extra, other.note) == (3, ["mine"])
        assert other.structure is not tracer.structure
