import numpy as np
import pytest

import raystream as rs
from conftest import EVERY_TREE, assert_same_bits
from meshes import dented_sphere, soup
from raystream.core.npz import read_npz, write_npz


@pytest.fixture
def scene():
    vertices, faces = dented_sphere(3)
    # A part of it far from finite and without area: both are kept, and never hit.
    vertices = np.vstack([vertices * 1e-3 + 5e4, [np.nan] * 3])
    faces = np.vstack([faces, [[0, 1, len(vertices) - 1], [0, 0, 1]]])
    return rs.Scene([rs.Mesh(vertices, faces), rs.Mesh(vertices, faces[:10])])


@pytest.fixture
def rays(scene, rng):
    low, high = scene.bounds
    origins = low + rng.random((2000, 3)) * (high - low)
    return origins, rng.normal(size=(2000, 3))


@pytest.mark.parametrize("make_tracer", EVERY_TREE, indirect=True)
def test_a_loaded_tracer_answers_alike(make_tracer, scene, rays, tmp_path):
    tracer = make_tracer(scene)
    tracer.save(tmp_path / "x.npz")
    for loaded in (rs.Tracer.load(tmp_path / "x.npz"), rs.Tracer.load(tmp_path / "x.npz", scene)):
        assert loaded.structure.name == tracer.structure.name
        assert loaded.structure.options == tracer.structure.options
        hits, expected = loaded.first_hit(*rays), tracer.first_hit(*rays)
        for column in ("t", "u", "v", "prim_id", "mesh_id", "positions", "normals"):
            assert_same_bits(getattr(hits, column), getattr(expected, column))
    assert rs.Tracer.load(tmp_path / "x.npz").scene.triangle_count == scene.triangle_count
    assert rs.Tracer.load(tmp_path / "x.npz", scene).scene is scene


@pytest.mark.parametrize("make_tracer", EVERY_TREE, indirect=True)
def test_an_empty_scene(make_tracer, tmp_path):
    make_tracer(rs.Scene()).save(tmp_path / "x.npz")
    assert not rs.Tracer.load(tmp_path / "x.npz").any_hit([0, 0, 0], [1, 0, 0])


@pytest.mark.parametrize("make_tracer", EVERY_TREE, indirect=True)
def test_another_scene_is_refused(make_tracer, scene, tmp_path):
    make_tracer(scene).save(tmp_path / "x.npz")
    with pytest.raises(rs.FileFormatError, match="other geometry"):
        rs.Tracer.load(tmp_path / "x.npz", rs.Scene.from_arrays(*soup(10)))


def test_foreign_files_are_refused(tmp_path):
    np.savez(tmp_path / "x.npz", origins=np.zeros((2, 3)))
    with pytest.raises(rs.FileFormatError, match=r"x\.npz: was not written by Tracer\.save"):
        rs.Tracer.load(tmp_path / "x.npz")
    with pytest.raises(rs.FileFormatError, match="no such file"):
        rs.Tracer.load(tmp_path / "none.npz")


def changed(path, name, change):
    """The file with one array changed."""
    arrays = read_npz(path)
    arrays[name] = change(arrays[name].copy())
    target = path.with_name("changed.npz")
    write_npz(target, arrays)
    return target


CHILD_COLUMN = 48


def put_bits(index, value):
    """Set an int32 in an array of float32: a link or a prim_id."""

    def change(array):
        array.view(np.int32)[index] = value
        return array

    return change


def put(index, value):
    def change(array):
        array[index] = value
        return array

    return change


def replaced(old, new):
    """Change the text of the header."""

    def change(header):
        text = header.tobytes()
        assert old in text
        return np.frombuffer(text.replace(old, new), np.uint8)

    return change


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("structure.nodes", put_bits((0, CHILD_COLUMN), 10**6)),  # out of range
        ("structure.nodes", put_bits((0, CHILD_COLUMN), -(2**31))),
        ("structure.nodes", put_bits((0, CHILD_COLUMN), 2**31 - 1)),
        ("structure.nodes", put_bits((0, CHILD_COLUMN), ~(10**6 << 3))),
        ("structure.nodes", put_bits((5, CHILD_COLUMN), 5)),  # a cycle
        ("structure.nodes", put_bits((0, CHILD_COLUMN), 0)),  # absent, but has a box
        ("structure.nodes", lambda a: np.repeat(a[:1], len(a), axis=0)),  # many parents
        ("structure.nodes", lambda a: a[:-1]),
        ("structure.nodes", lambda a: a[:0]),
        ("structure.nodes", lambda a: a.astype(np.float64)),
        ("structure.nodes", lambda a: a.reshape(-1)),
        ("structure.nodes", lambda a: np.array(1.0, np.float32)),
        ("structure.nodes", lambda a: a.reshape(-1, 32)),
        ("structure.leaves", lambda a: a[:-1]),
        ("structure.leaves", lambda a: a[:, ::-1]),
        ("structure.leaves", put_bits((0, 36), 10**6)),
        ("structure.leaves", put_bits((0, 36), 2**31 - 1)),
        ("structure.leaves", put_bits((0, 36), -1)),
        ("structure.leaves", put_bits((0, 36), -2)),
        ("structure.leaves", put_bits((0, 36), 0)),  # another triangle's number
        ("structure.leaves", put((0, 0), 1e9)),  # a corner of no triangle
        ("structure.leaves", put((0, 0), np.nan)),
        ("triangles.corners", lambda a: a[:-1]),
        ("triangles.corners", lambda a: a.astype(np.float64)),
        ("triangles.corners", lambda a: a[:, :2]),
        ("triangles.mesh_splits", lambda a: a[::-1].copy()),
        ("triangles.mesh_splits", lambda a: a[:0]),
        ("triangles.center", put(0, np.nan)),
        ("triangles.scale", lambda a: np.array(0.0)),
        ("triangles.scale", lambda a: np.array(3.0)),
        ("triangles.scale", lambda a: np.array(np.inf)),
        ("header", replaced(b'"balanced"', b'"perfect"')),
        ("header", replaced(b'"balanced"', b'["balanced"]')),
        ("header", replaced(b'"balanced"', b"0")),
        ("header", replaced(b'"max_leaf_size": 4', b'"max_leaf_size": 0')),
        ("header", replaced(b'"max_leaf_size": 4', b'"max_leaf_size": 4.0')),
        ("header", replaced(b'"max_leaf_size": 4', b'"max_leaf_size": null')),
        ("header", replaced(b'"max_leaf_size"', b'"most"')),
        ("header", replaced(b'"options"', b'"option"')),
        ("header", replaced(b'"bvh"', b'"kdtree"')),
        ("header", replaced(b'"bvh"', b'["bvh"]')),
        ("header", lambda a: a[:-3]),
        ("header", lambda a: np.frombuffer(b"[]", np.uint8)),
        ("header", lambda a: np.frombuffer(b"[" * 100_000, np.uint8)),
    ],
)
def test_hostile_files_are_refused(scene, tmp_path, name, change):
    rs.Tracer(scene).save(tmp_path / "x.npz")
    path = changed(tmp_path / "x.npz", name, change)
    with pytest.raises(rs.FileFormatError, match=r"changed\.npz: "):
        rs.Tracer.load(path)


def test_other_versions_are_refused_with_advice(scene, tmp_path):
    rs.Tracer(scene, "brute").save(tmp_path / "x.npz")

    def newer(header):
        text = header.tobytes().replace(b'"version": 3', b'"version": 99')
        return np.frombuffer(text, np.uint8)

    with pytest.raises(rs.FileFormatError, match=r"version 99.*rebuild the structure"):
        rs.Tracer.load(changed(tmp_path / "x.npz", "header", newer))


@pytest.mark.parametrize(
    ("structure", "old", "new", "words"),
    [
        ("bvh", b'"balanced"', b'"high"', "quality: expected .*'high'; rebuild the structure"),
        ("kdtree", b'"empty_bonus": 0.2', b'"empty_bonus": NaN', "empty_bonus: expected 0 to 1"),
        ("kdtree", b'"max_depth": null', b'"max_depth": 65', "max_depth: expected 0 to 64"),
        ("kdtree", b'"traversal_cost": 8.0', b'"traversal_cost": 1' + b"0" * 400, "too large"),
        ("graph", b'"link_cost": 16.0', b'"link_cost": "x"', "link_cost: could not convert"),
        ("grid", b'"resolution": null', b'"resolution": [1, 2]', "one number or three, got 2"),
        ("grid", b'"resolution": null', b'"resolution": {"x": 1}', "one number or three, got 1"),
        ("grid", b'"levels": 1', b'"levels": 3', "levels: expected 1 to 2, got 3"),
        ("brute", b'"options": {}', b'"options": {"x": 1}', "invalid options: expected none"),
        ("brute", b'"options": {}', b'"options": []', "invalid options: expected none"),
    ],
)
def test_hostile_options_are_refused(scene, tmp_path, structure, old, new, words):
    rs.Tracer(scene, structure).save(tmp_path / "x.npz")
    path = changed(tmp_path / "x.npz", "header", replaced(old, new))
    with pytest.raises(rs.FileFormatError, match=f"changed.npz: .*{words}"):
        rs.Tracer.load(path)


def test_a_cycle_deep_in_the_tree_is_found(scene, tmp_path):
    """A child that points back would make a traversal run forever."""
    rs.Tracer(scene, max_leaf_size=1).save(tmp_path / "x.npz")

    def cycle(nodes):
        links = nodes.view(np.int32)[:, CHILD_COLUMN : CHILD_COLUMN + 8]
        node, lane = np.argwhere(links > 0)[-1]
        links[node, lane] = node
        return nodes

    with pytest.raises(rs.FileFormatError, match="out of range"):
        rs.Tracer.load(changed(tmp_path / "x.npz", "structure.nodes", cycle))


def test_a_node_with_two_parents_is_refused(scene, tmp_path):
    """Doubled repeatedly, it would make a traversal run almost forever."""
    rs.Tracer(scene).save(tmp_path / "x.npz")

    def two_parents(nodes):
        links = nodes.view(np.int32)[:, CHILD_COLUMN : CHILD_COLUMN + 8]
        (first, second), *_ = np.argwhere((links[:, :-1] > 0) & (links[:, 1:] > 0))
        links[first, second] = links[first, second + 1]
        return nodes

    with pytest.raises(rs.FileFormatError, match="two parents"):
        rs.Tracer.load(changed(tmp_path / "x.npz", "structure.nodes", two_parents))


def test_failing_to_write_names_the_file(scene, tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nowhere.x\.npz"):
        rs.Tracer(scene).save(tmp_path / "nowhere" / "x.npz")
    with pytest.raises(TypeError, match="scene: expected a Scene"):
        rs.Tracer.load(tmp_path / "x.npz", "scene")
