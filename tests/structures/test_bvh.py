"""The BVH as a structure: options, its report, and trees of files."""

import numpy as np
import pytest

import raystream as rs
from meshes import soup
from raystream.structures.bvh.layout import CHILDREN_AT, WIDTH
from raystream.structures.bvh.structure import BvhStructure


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


@pytest.mark.parametrize("value", ["best", "high", "stream", "", None, 3])
def test_names_are_checked(value):
    with pytest.raises(ValueError, match="quality: expected one of 'fast', 'balanced', got"):
        build(*soup(2), quality=value)
    kernels = "'auto', 'wavefront', 'packet', 'groups', 'single'"
    with pytest.raises(ValueError, match=f"kernel: expected one of {kernels}, got {value!r}"):
        build(*soup(2), kernel=value)


def test_the_options_are_kept():
    structure = build(*soup(2), quality="fast", kernel="single")
    assert structure.options == rs.Bvh(quality="fast", kernel="single")


def test_the_report_counts_the_bytes():
    structure = build(*soup(500, 1))
    assert structure.report.byte_count == sum(array.nbytes for array in structure.tree)
    assert structure.report.seconds > 0
    quality = structure.quality()
    assert structure.report.byte_count == 256 * quality["nodes"] + 160 * quality["leaf blocks"]


def test_a_tree_with_a_triangle_in_several_leaves_is_refused():
    """Its hits would be found several times."""
    structure = build(*soup(300, 1))
    nodes, leaves = (array.copy() for array in structure.tree)
    children = nodes.view(np.int32)[:, CHILDREN_AT // 4 : CHILDREN_AT // 4 + WIDTH]
    row, lane = np.argwhere(children == 0)[0]
    other_row, other_lane = np.argwhere(children < 0)[0]
    children[row, lane] = children[other_row, other_lane]
    boxes = nodes[:, :48].reshape(-1, 6, 8)
    boxes[row, :, lane] = boxes[other_row, :, other_lane]
    arrays = {"nodes": nodes, "leaves": leaves}
    with pytest.raises(ValueError, match=r"in more than one leaf; rebuild the structure"):
        BvhStructure.from_arrays(structure.triangles, arrays, structure.options)
