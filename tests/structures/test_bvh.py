import numpy as np
import pytest

import raystream as rs
from conftest import assert_same_bits
from meshes import dented_sphere, lattice_soup, soup
from raystream.structures.bvh.layout import MAX_DEPTH


def build(vertices, faces, **options):
    return rs.Tracer(rs.Scene.from_arrays(vertices, faces), **options).structure


def walk(tree):
    """Check every node against the triangles below it; returns the leaf rows seen."""
    rows = []
    pending = [(0, None)]
    while pending:
        node, box = pending.pop()
        for child in range(2):
            low, high = tree.boxes[node, child]
            index, count = tree.children[node, child]
            if count < 0:
                assert (low > high).all()
                continue
            if box is not None:
                assert (low >= box[0]).all()
                assert (high <= box[1]).all()
            if count:
                corners = tree.corners[index : index + count]
                np.testing.assert_array_equal(corners.min(axis=(0, 1)), low)
                np.testing.assert_array_equal(corners.max(axis=(0, 1)), high)
                rows.extend(range(index, index + count))
            else:
                assert index > node
                pending.append((index, (low, high)))
    return rows


@pytest.mark.parametrize("max_leaf_size", [1, 4, 64])
@pytest.mark.parametrize("mesh", [soup(1), soup(2), soup(500), dented_sphere(3), lattice_soup(200)])
def test_every_triangle_is_in_one_leaf_and_every_box_is_tight(mesh, max_leaf_size):
    structure = build(*mesh, max_leaf_size=max_leaf_size)
    tree, triangles = structure.arrays, structure.triangles
    assert sorted(walk(tree)) == list(range(len(triangles.prim_ids)))
    np.testing.assert_array_equal(np.sort(tree.prim_ids), triangles.prim_ids)
    np.testing.assert_array_equal(tree.corners, triangles.corners[tree.prim_ids])
    assert tree.children[:, :, 1].max() <= max_leaf_size


def test_large_scenes_are_split_among_tasks_and_joined():
    vertices, faces = soup(40_000, 4, 0.01)
    structure = build(vertices, faces)
    assert sorted(walk(structure.arrays)) == list(range(40_000))
    assert structure.quality()["depth"] < 60


def test_the_tree_does_not_depend_on_the_number_of_threads():
    mesh = soup(40_000, 9, 0.01)
    try:
        rs.set_thread_count(1)
        alone = build(*mesh).arrays
        rs.set_thread_count(5)
        together = build(*mesh).arrays
    finally:
        rs.set_thread_count(None)
    for a, b in zip(alone, together, strict=True):
        assert_same_bits(a, b)


def test_equal_triangles_are_halved_by_count():
    vertices, faces = soup(1)
    structure = build(vertices, np.repeat(faces, 20_000, axis=0))
    assert structure.quality()["depth"] <= 16
    hits = rs.Tracer(rs.Scene.from_arrays(vertices, np.repeat(faces, 50, axis=0))).multi_hit(
        vertices.mean(axis=0) - [0, 0, 3], [0, 0, 3]
    )
    assert hits.prim_id.tolist() == list(range(50))


def test_a_scene_that_grows_by_a_factor_from_triangle_to_triangle_stays_within_the_stack():
    """Binning splits off the largest ones only: the deepest trees there are."""
    base = np.array([[0, 0, 0], [1, 0, 0.1], [0, 1, 0.2]])
    sizes = 2.0 ** -np.arange(0, 120, 0.05)
    vertices = (base[None] * sizes[:, None, None] + sizes[:, None, None] * 3).reshape(-1, 3)
    faces = np.arange(len(vertices)).reshape(-1, 3)
    structure = build(vertices, faces, max_leaf_size=1)
    assert sorted(walk(structure.arrays)) == list(range(len(structure.triangles.prim_ids)))
    assert structure.quality()["depth"] <= MAX_DEPTH


def test_the_tree_is_worth_building():
    quality = build(*soup(5000, 2, 0.02)).quality()
    assert quality["expected nodes and triangles per ray"] < 500


@pytest.mark.parametrize("value", [0, 65, -1])
def test_options_are_checked(value):
    with pytest.raises(ValueError, match="max_leaf_size"):
        build(*soup(2), max_leaf_size=value)
    with pytest.raises(TypeError, match="leaf"):
        build(*soup(2), leaf=value)


def test_progress_while_building():
    seen = []
    build(*soup(40_000, 9, 0.01), progress=lambda done, total: seen.append((done, total)))
    assert seen[-1] == (40_000, 40_000)
    assert seen == sorted(seen)


def test_building_can_be_interrupted():
    def interrupt(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build(*soup(40_000, 9, 0.01), progress=interrupt)
