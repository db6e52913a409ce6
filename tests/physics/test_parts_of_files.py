"""Solids of files: groups of OBJ, and nodes of glTF that have several materials."""

from __future__ import annotations

import json

import numpy as np
import pytest

import raystream as rs
from scene.io import tiny
from scene.io.test_parts import FACES, VERTICES, document, two_halves

#: A line along x through the middle of a box of 2 units, with one of half a unit inside.
LINE = [[-5.0, 0.1, 0.2]], [[1.0, 0.0, 0.0]]


def box(first, size, groups, faces=FACES):
    """Lines of OBJ: a box around the origin, its faces in one group, or divided among several."""
    lines = [f"v {x} {y} {z}" for x, y, z in (VERTICES - 0.5) * size]
    for k, (a, b, c) in enumerate((faces + first).tolist()):
        step = len(faces) // len(groups)
        lines += [groups[k // step]] if k % step == 0 else []
        lines.append(f"f {a} {b} {c}")
    return lines


def tracer_of(folder, lines):
    path = folder / "cad.obj"
    path.write_text("\n".join(lines) + "\n")
    return rs.Tracer(rs.load(path))


def lengths(tracer):
    """Total length and completeness of each part on the line."""
    found = rs.thickness(tracer, *LINE)
    sums = found.total_length(by="mesh")[0].tolist()
    return dict(zip(found.mesh_names, sums, strict=True)), bool(found.is_complete.all())


@pytest.mark.parametrize(
    "hull",
    [["g hull"], ["g hull", "g hull"], ["g hull\nusemtl red", "g hull\nusemtl blue"]],
    ids=["one", "reopened", "materials"],
)
@pytest.mark.parametrize("kind", ["g", "o"])
@pytest.mark.filterwarnings("ignore:thickness. meshes overlap")
def test_groups_of_an_obj_are_solids(tmp_path, hull, kind):
    """Of [2.0] of one part before: the inner one vanished within it."""
    lines = [*box(1, 2.0, hull), *box(9, 0.5, [f"{kind} engine"])]
    tracer = tracer_of(tmp_path, lines)
    assert lengths(tracer) == ({"hull": 2.0, "engine": 0.5}, True)
    found = rs.thickness(tracer, *LINE)
    passed = rs.attenuation(found, {"hull": 0.25, "engine": 1.0}, by="mesh")
    assert passed[0] == pytest.approx(np.exp(-1.0))


@pytest.mark.filterwarnings("ignore:thickness. meshes overlap")
def test_a_group_around_another_is_one_solid(tmp_path):
    """Half of the hull comes before the engine, and half after it."""
    first, second = box(1, 2.0, ["g hull", "g hull"])[:15], box(1, 2.0, ["g hull", "g hull"])[15:]
    lines = [*first, *box(9, 0.5, ["g engine"]), *second]
    assert lengths(tracer_of(tmp_path, lines)) == ({"hull": 2.0, "engine": 0.5}, True)


def gltf(folder, made, suffix="gltf", **options):
    path = folder / f"a.{suffix}"
    path.write_bytes(json.dumps(made).encode() if suffix == "gltf" else tiny.glb_of(made))
    return rs.Tracer(rs.load(path, **options))


def halves_of_a_box():
    """A cube of side 2 around the origin: two primitives with materials of their own."""
    primitives = two_halves()
    for primitive in primitives:
        primitive["POSITION"] = 2.0 * primitive["POSITION"] - 1.0
    return primitives


@pytest.mark.parametrize("suffix", ["gltf", "glb"])
def test_a_box_of_two_materials_is_closed(tmp_path, suffix):
    tracer = gltf(tmp_path, document([{"mesh": 0}], ("m", halves_of_a_box())), suffix)
    assert lengths(tracer) == ({"m": 2.0}, True)
    assert tracer.contains([[0.0, 0.1, 0.2], [3.0, 0.0, 0.0]]).tolist() == [True, False]
    assert tracer.signed_distance([[0.0, 0.1, 0.2]]).tolist() == pytest.approx([-0.8])
    found = rs.thickness(tracer, *LINE)
    assert found.mesh_is_closed.tolist() == [True]
    assert rs.attenuation(found, {"m": 0.5}, by="mesh")[0] == pytest.approx(np.exp(-1.0))


def test_boxes_of_two_materials_in_a_tree(tmp_path):
    """Mirrored and moved; the names tell the wheels apart."""
    nodes = [
        {"name": "car", "children": [1, 2]},
        {"name": "front", "children": [3], "translation": [3, 0, 0]},
        {"name": "rear", "mesh": 0, "scale": [-1, 1, 1]},
        {"name": "wheel", "mesh": 0, "scale": [0.5, 0.5, 0.5]},
    ]
    made = document(nodes, halves_of_a_box())
    expected = {"car/front/wheel": 1.0, "car/rear": 2.0}
    assert lengths(gltf(tmp_path, made)) == (expected, True)
    placed = gltf(tmp_path, made, instances=True)
    found = rs.thickness(placed, *LINE)
    names = placed.scene.placements.names
    parts = zip(found.instance_id.tolist(), found.path_length.tolist(), strict=True)
    assert {names[k]: length for k, length in parts} == expected
    assert lengths(rs.Tracer(placed.scene.flattened())) == (expected, True)


def test_copies_of_a_box_of_two_materials(tmp_path):
    made = document([{"name": "crate", "mesh": 0}], halves_of_a_box())
    made = tiny.with_accessor(made, np.array([[0, 0, 0], [3, 0, 0]], np.float32))
    extension = {"attributes": {"TRANSLATION": len(made["accessors"]) - 1}}
    made["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": extension}
    assert lengths(gltf(tmp_path, made)) == ({"crate": 2.0, "crate_2": 2.0}, True)
    found = rs.thickness(gltf(tmp_path, made, instances=True), *LINE)
    assert found.path_length.tolist() == [2.0, 2.0]
    assert found.is_complete.all()
