"""``raystream info``."""

from __future__ import annotations

import json

import numpy as np
import pytest

import raystream as rs
from scene.io import tiny


def test_figures_as_json(run, square):
    figures = run("info", square, "--json").figures
    assert figures["scene"] == str(square)
    assert figures["triangles"] == 2
    assert figures["degenerate_triangles"] == figures["nonfinite_triangles"] == 0
    assert figures["vertices"] == 4
    assert figures["bounds"] == {"low": [0, 0, 0], "high": [1, 1, 0]}
    camera = rs.load(square).camera
    assert figures["camera"] == {
        "eye": pytest.approx(camera.eye),
        "look_at": [0.5, 0.5, 0.0],
        "up": [0.0, 1.0, 0.0],
        "fov": 40.0,
        "projection": "perspective",
        "height": None,
        "aperture": 0.0,
        "focus": None,
    }
    assert figures["background"] == [0, 0, 0]
    assert [mesh["triangles"] for mesh in figures["meshes"]] == [2]
    assert set(figures["meshes"][0]) == {
        *("name", "triangles", "vertices", "attributes", "is_closed")
    }
    assert not figures["meshes"][0]["is_closed"]
    assert not figures["is_closed"]
    red = next(m for m in figures["materials"] if m["name"] == "red")
    assert red["triangles"] == 2
    assert red["diffuse"] == [0.8, 0.1, 0.1]
    assert red["textures"] == {}
    assert figures["lights"] == []
    assert set(figures["memory"]) == {"scene", "triangles", "structure"}
    assert all(size > 0 for size in figures["memory"].values())
    assert figures["structure"]["name"] == "bvh"
    assert figures["structure"]["quality"]["nodes"] >= 1
    assert set(figures["seconds"]) - {"compile"} == {"load", "build"}


def test_it_says_whether_meshes_are_closed(run, tmp_path):
    def shown(scene):
        rows = [line.split(maxsplit=1) for line in run("info", scene).out.splitlines()]
        return next((row[1] for row in rows if row[:1] == ["closed"]), None)

    assert shown("spheres") == "all"
    assert shown("cornell") == "2 of 8"
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
    faces = ["f 1 3 2", "f 1 2 4", "f 1 4 3", "f 2 3 4"]
    (tmp_path / "solid.obj").write_text(corners + "\n".join(faces))
    assert shown("solid.obj") == "yes"
    (tmp_path / "open.obj").write_text(corners + "\n".join(faces[1:]))
    assert shown("open.obj") == "no"
    halves = ["o a", *faces[:2], "o b", *faces[2:]]
    (tmp_path / "halves.obj").write_text(corners + "\n".join(halves))
    assert shown("halves.obj") == "0 of 2; together they are"
    # The edge from (0, 0, 1) to (0, 1, 0) is split on one side; a triangle without area closes it.
    split = "v 0 0.5 0.5\n" + "\n".join([*faces[:2], "f 1 4 5", "f 1 5 3", faces[3], "f 4 3 5"])
    (tmp_path / "split.obj").write_text(corners + split)
    assert shown("split.obj") == "yes"
    (tmp_path / "empty.obj").write_text("")
    assert shown("empty.obj") is None


def test_it_lists_the_parts_of_files(run, tmp_path):
    """A box in two groups and two materials, and the same in two nodes."""
    (tmp_path / "parts.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\no truck\ng hull\nf 1 3 2\ng tip\nf 1 2 4\nf 1 4 3\n"
        "g hull\nf 2 3 4\n"
    )
    triangle = {"POSITION": np.eye(3, dtype=np.float32)}
    wheel = {"name": "wheel", "mesh": 0}
    nodes = [{"name": "truck", "children": [1, 2]}, wheel, wheel]
    (tmp_path / "parts.gltf").write_text(json.dumps(tiny.gltf_of([[triangle, triangle]], nodes)))
    for name, parts in (
        ("parts.obj", ["truck/hull", "truck/tip"]),
        ("parts.gltf", ["truck/wheel", "truck/wheel_2"]),
    ):
        told = run("info", name, "--json").figures["meshes"]
        assert [(mesh["name"], mesh["triangles"]) for mesh in told] == [(part, 2) for part in parts]
        words = run("info", name).out.split()
        assert set(parts) < set(words)


def test_projections_are_shown_as_the_option_takes_them(run, tmp_path):
    box = {"xmag": 2, "ymag": 1.5, "znear": 0, "zfar": 9}
    document = {
        "asset": {"version": "2.0"},
        "nodes": [{"camera": 0}],
        "cameras": [{"type": "orthographic", "orthographic": box}],
    }
    (tmp_path / "flat.gltf").write_text(json.dumps(document))
    camera = run("info", "flat.gltf", "--json").figures["camera"]
    assert (camera["projection"], camera["height"]) == ("orthographic", 3.0)
    assert "--projection orthographic --view-height 3" in " ".join(
        run("info", "flat.gltf").out.split()
    )
    assert "projection" not in run("info", "cornell").out


def test_lights_as_json(run):
    area = run("info", "cornell", "--json").figures["lights"]
    assert area == [{"type": "area", "mesh_id": 7, "triangles": 2, "radiance": [17, 12, 4]}]
    lights = run("info", "robots:500", "--json").figures["lights"]
    assert [light["type"] for light in lights] == ["directional", "environment"]
    assert len(lights[0]["direction"]) == 3


def test_skipped_triangles_are_counted(run, tmp_path):
    (tmp_path / "bad.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv inf 0 0\nv 2 0 0\nf 1 2 3\nf 1 2 4\nf 1 2 5\nf 1 1 2\n"
    )
    figures = run("info", "bad.obj", "--json").figures
    assert figures["degenerate_triangles"] == 2
    assert figures["nonfinite_triangles"] == 1
    assert figures["triangles"] == 4
    assert figures["bounds"] == {"low": [0, 0, 0], "high": [1, 1, 0]}


def test_nothing_to_hit_has_no_bounds(run, tmp_path):
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n")
    result = run("info", "flat.obj", "--json")
    assert result.figures["bounds"] is None
    assert "nothing can be hit" in run("info", "flat.obj").out


@pytest.mark.ci
def test_instances_are_counted(run, tmp_path):
    """A building above 500 million triangles has instances."""
    figures = run("info", "building:600000000", "--json").figures
    assert figures["triangles"] < 300_000
    assert abs(figures["instanced_triangles"] - 600e6) < 1e6
    count = f"{figures['instances']:,}"
    assert count in run("info", "building:600000000").out
    said = run("render", "building:600000000", "-o", tmp_path / "a.png", "--size", "8x8").out
    assert f"{figures['instanced_triangles']:,} triangles in {count} instances" in said
    assert "is_closed" not in figures
    assert "instances" not in run("info", "cornell", "--json").figures


def test_table_for_people(run, square):
    result = run("info", square)
    assert result.code == 0
    assert result.err == ""
    lines = [line.split() for line in result.out.splitlines()]
    assert ["triangles", "2"] in lines
    assert ["high", "corner", "1", "1", "0"] in lines
    assert ["0", "red", "2", "0.8", "0.1", "0.1"] in [line for line in lines if "red" in line]
    assert "\x1b" not in result.out
    assert not any(line != line.rstrip() for line in result.out.splitlines())


def test_camera_is_shown_as_render_takes_it(run):
    out = run("info", "cornell").out
    line = next(line for line in out.splitlines() if line.startswith("camera"))
    shown = line.removeprefix("camera").strip()
    assert shown == "--eye 278 273 -800 --look-at 278 273 0 --up 0 1 0 --fov 39.3"
    assert run("render", "cornell", "--size", "8x6", *shown.split()).code == 0


def test_many_meshes_are_cut_short_for_people_only(run, tmp_path):
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
    parts = [f"newmtl m{i}\nKd 0 0 0.{i:02}\n" for i in range(30)]
    (tmp_path / "many.mtl").write_text("".join(parts))
    faces = "".join(f"usemtl m{i}\nf 1 2 3\n" for i in range(30))
    (tmp_path / "many.obj").write_text(f"mtllib many.mtl\n{corners}{faces}")
    assert "and 18 more materials (--json lists all)" in run("info", "many.obj").out
    assert len(run("info", "many.obj", "--json").figures["materials"]) == 30


def test_names_cannot_move_the_cursor(run, monkeypatch, square):
    scene = rs.Scene.from_arrays(np.eye(3), [[0, 1, 2]], name="\x1b[2Jcube\n[bold]")
    monkeypatch.setattr("raystream.scene.load.load", lambda *_, **__: scene)
    out = run("info", square).out
    assert "\x1b" not in out
    assert " ?[2Jcube [bold] " in out


@pytest.mark.parametrize("structure", ["bvh", "brute"])
def test_saved_structure(run, tmp_path, square, structure):
    rs.Tracer(rs.load(square), structure).save(tmp_path / "saved.npz")
    figures = run("info", "saved.npz", "--json").figures
    assert figures["structure"]["name"] == structure
    assert figures["triangles"] == 2
    other = {"bvh": "brute", "brute": "bvh"}[structure]
    assert "saved.npz" in run("info", "saved.npz", "--structure", other).complaint
    assert "saved.npz" in run("info", "saved.npz", "--triangles", 5).complaint


def test_scenes_without_triangles(run, rays, tmp_path):
    (tmp_path / "points.obj").write_text("v 1 2 3\n")
    done = run("info", "points.obj", "--json")
    assert (done.code, done.err) == (0, "warning: points.obj: holds no triangles\n")
    assert done.figures["triangles"] == 0
    assert done.figures["bounds"] is None
    assert "nothing can be hit" in run("info", "points.obj").out
    figures = run("query", "points.obj", rays, "-o", "hits.npz", "--json").figures
    assert (figures["rays"], figures["rays_hit"]) == (4, 0)
