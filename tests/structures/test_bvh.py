"""The BVH as a structure: options, kernels, and trees that list a triangle in several leaves."""

import numpy as np
import pytest

import raystream as rs
from conftest import assert_same_bits
from meshes import dented_sphere, lattice_soup, soup
from raystream.structures.bvh.kernel_choice import KERNELS
from raystream.structures.bvh.layout import CHILDREN_AT, WIDTH
from raystream.structures.bvh.structure import BvhStructure
from test_agreement import assert_same_answers


def build(vertices, faces, **options):
    return rs.Tracer(rs.Scene.from_arrays(vertices, faces), **options).structure


@pytest.mark.parametrize("value", [0, 33, -1])
def test_leaf_sizes_are_checked(value):
    with pytest.raises(ValueError, match="max_leaf_size: expected 1 to 32"):
        build(*soup(2), max_leaf_size=value)
    with pytest.raises(TypeError, match="leaf"):
        build(*soup(2), leaf=value)
    with pytest.raises(TypeError):
        build(*soup(2), max_leaf_size=2.5)


@pytest.mark.parametrize("value", ["best", "", None, 3])
def test_names_are_checked(value):
    with pytest.raises(ValueError, match="quality: expected one of 'fast', 'balanced', 'high'"):
        build(*soup(2), quality=value)
    with pytest.raises(ValueError, match="kernel: expected one of 'auto', 'wavefront', 'packet'"):
        build(*soup(2), kernel=value)


def test_the_options_are_kept():
    structure = build(*soup(2), quality="high", kernel="single")
    assert structure.options == rs.Bvh(quality="high", kernel="single")
    assert structure.kernel == "single"


def test_the_report_counts_the_bytes():
    structure = build(*soup(500, 1))
    assert structure.report.byte_count == sum(array.nbytes for array in structure.tree)
    assert structure.report.seconds > 0
    quality = structure.quality()
    assert structure.report.byte_count == 256 * quality["nodes"] + 160 * quality["leaf blocks"]


def with_leaves_repeated(structure: BvhStructure) -> BvhStructure:
    """The same tree with some of its leaves in absent lanes too, of the same and of other nodes."""
    nodes, leaves = (array.copy() for array in structure.tree)
    children = nodes.view(np.int32)[:, CHILDREN_AT // 4 : CHILDREN_AT // 4 + WIDTH]
    boxes = nodes[:, :48].reshape(-1, 6, 8)
    places = np.argwhere(children < 0)
    added = 0
    for row, lane in np.argwhere(children == 0):
        if lane and children[row, lane - 1] == 0:
            continue
        other_row, other_lane = places[(7 * added) % len(places)]
        children[row, lane] = children[other_row, other_lane]
        boxes[row, :, lane] = boxes[other_row, :, other_lane]
        added += 1
    assert added
    # Parents' boxes need not hold the strangers: where they do not, those are just not found.
    arrays = {**structure.saved_arrays(), "nodes": nodes, "leaves": leaves}
    return BvhStructure.from_arrays(structure.triangles, arrays, structure.options)


@pytest.mark.parametrize("mesh", [soup(300, 1), dented_sphere(2), lattice_soup(80)])
@pytest.mark.parametrize("kernel", KERNELS)
def test_a_triangle_in_several_leaves_counts_once(mesh, kernel, rng):
    tracer = rs.Tracer(rs.Scene.from_arrays(*mesh), kernel=kernel)
    oracle = rs.Tracer(rs.Scene.from_arrays(*mesh), "brute")
    structure = with_leaves_repeated(tracer.structure)
    structure._has_duplicates = True
    structure.options = rs.Bvh(kernel=kernel)
    tracer.structure = structure
    low, high = mesh[0].min(axis=0), mesh[0].max(axis=0)
    origins = low + rng.random((300, 3)) * (high - low) + rng.normal(size=(300, 3))
    rays = {"origins": origins, "directions": low + rng.random((300, 3)) * (high - low) - origins}
    assert_same_answers(tracer, oracle, rays)


def test_many_hits_of_triangles_in_several_leaves(rng):
    """More than fit in the first set of triangles seen."""
    count = 20_000
    corners = np.empty((count, 3, 3))
    corners[:, :, :2] = [[-1, -1], [3, -1], [-1, 3]]
    corners[:, :, 2] = rng.permutation(count)[:, None] / 100
    faces = np.arange(3 * count).reshape(-1, 3)
    tracer = rs.Tracer(rs.Scene.from_arrays(corners.reshape(-1, 3), faces))
    rays = [[0, 0, -1], [0.1, 0, 999], [5, 5, 5]], [[0.0, 0, 1], [0, 0, -1], [0, 0, 1]]
    expected = tracer.multi_hit(*rays)
    tracer.structure = with_leaves_repeated(tracer.structure)
    tracer.structure._has_duplicates = True
    found = tracer.multi_hit(*rays)
    assert found.counts.tolist() == [count, count, 0]
    for column in ("ray_splits", "t", "u", "v", "prim_id"):
        assert_same_bits(getattr(found, column), getattr(expected, column))
    assert tracer.count_hits(*rays).tolist() == [count, count, 0]
    few = tracer.multi_hit(*rays, max_hits=100)
    np.testing.assert_array_equal(few.prim_id[:100], expected.prim_id[:100])
    assert few.counts.tolist() == [100, 100, 0]


def test_cut_triangles_are_noticed():
    """High quality cuts long triangles: the structure knows it, and hits each once."""
    rng = np.random.default_rng(3)
    begin = rng.random((2000, 3))
    end = begin + rng.normal(size=(2000, 3)) * 0.3
    corners = np.stack([begin, end, end + rng.normal(size=(2000, 3)) * 0.01], axis=1)
    scene = rs.Scene.from_arrays(corners.reshape(-1, 3), np.arange(6000).reshape(-1, 3))
    tracer = rs.Tracer(scene, quality="high")
    assert tracer.structure.quality()["references"] > 2000
    assert tracer.structure.has_duplicates
    assert not rs.Tracer(scene).structure.has_duplicates
    origins = rng.random((500, 3)) * 3 - 1
    rays = {"origins": origins, "directions": rng.random((500, 3)) - origins}
    assert_same_answers(tracer, rs.Tracer(scene, "brute"), rays)
