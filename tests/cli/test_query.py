"""``raystream query``."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import raystream as rs
from instanced import random_transforms
from meshes import cube
from raystream.cli.zarr_query import QUERIES

FIGURES = {
    "output",
    "scene",
    "query",
    "structure",
    "machine",
    "device",
    "triangles",
    "rays",
    "invalid_rays",
    "rays_hit",
    "hits",
    "seconds",
    "mrays_per_second",
}


def arrays(path) -> dict[str, np.ndarray]:
    with np.load(path, allow_pickle=False) as file:
        return dict(file)


@pytest.mark.parametrize("options", [[], ["--first"]])
def test_first_hits(run, square, rays, options):
    result = run("query", square, rays, "-o", "hits.npz", *options)
    assert result.code == 0
    assert result.err == ""
    assert result.out.startswith("hits.npz: 4 rays (1 invalid), 2 hit; 2 triangles; load ")
    hits = arrays("hits.npz")
    assert set(hits) == {"t", "u", "v", "prim_id", "mesh_id", "face_id", "status"}
    np.testing.assert_array_equal(hits["t"], [[1, 2], [np.inf, np.inf]])
    np.testing.assert_array_equal(hits["prim_id"], [[0, 1], [-1, -1]])
    np.testing.assert_array_equal(hits["mesh_id"], [[0, 0], [-1, -1]])
    np.testing.assert_array_equal(hits["status"], [[0, 0], [0, 1]])
    assert hits["t"].dtype == np.float32


def test_anything_in_the_way(run, square, rays):
    run("query", square, rays, "-o", "hits.npz", "--any")
    hits = arrays("hits.npz")
    assert set(hits) == {"hit"}
    np.testing.assert_array_equal(hits["hit"], [[True, True], [False, False]])


def test_counts(run, square, tmp_path):
    """On the diagonal both triangles are met, and one surface is crossed."""
    np.savez(tmp_path / "edge.npz", origins=[[0.5, 0.5, 1]], directions=[[0, 0, -1]])
    run("query", square, "edge.npz", "-o", "all.npz", "--count")
    run("query", square, "edge.npz", "-o", "one.npz", "--count", "--crossings", "surfaces")
    assert arrays("all.npz")["count"].tolist() == [2]
    assert arrays("one.npz")["count"].tolist() == [1]


@pytest.mark.parametrize("options", [{}, {"max_hits": 1}, {"crossings": "surfaces"}])
@pytest.mark.parametrize("structure", ["bvh", "brute"])
def test_all_hits_are_the_librarys(run, tmp_path, options, structure):
    rng = np.random.default_rng(5)
    given = {
        "origins": np.array([[278.0, 273.0, -800.0]]),
        "directions": rng.normal((0, 0, 3), 1, (500, 3)).astype(np.float32),
        "t_min": np.array(250.0),
        "t_max": rng.uniform(300, 2000, 500),
    }
    np.savez(tmp_path / "rays.npz", **given)
    named = [word for key, value in options.items() for word in (f"--{key}", str(value))]
    named = [word.replace("_", "-") for word in named]
    result = run(
        *("query", "cornell", "rays.npz", "-o", "hits.npz", "--multi", "--json"),
        *("--structure", structure, *named),
    )
    expected = rs.Tracer(rs.load("cornell"), structure).multi_hit(**given, **options)
    found = arrays("hits.npz")
    assert set(found) == {"ray_splits", "t", "u", "v", "prim_id", "mesh_id", "face_id", "status"}
    for name, array in found.items():
        np.testing.assert_array_equal(array, getattr(expected, name))
    figures = result.figures
    assert set(figures) == FIGURES
    assert figures["query"] == "multi"
    assert figures["structure"] == structure
    assert (figures["rays"], figures["invalid_rays"]) == (500, 0)
    assert figures["hits"] == len(expected.t) > 100
    assert figures["rays_hit"] == np.count_nonzero(np.diff(expected.ray_splits))


INSTANCES = {
    "first": {"t", "u", "v", "prim_id", "mesh_id", "face_id", "instance_id", "status"},
    "multi": {
        "ray_splits",
        "t",
        "u",
        "v",
        "prim_id",
        "mesh_id",
        "face_id",
        "instance_id",
        "status",
    },
    "any": {"hit"},
    "count": {"count"},
}


@pytest.mark.parametrize("kind", INSTANCES)
def test_hits_in_instances_say_which(run, tmp_path, monkeypatch, kind):
    """The same columns as in a Zarr store."""
    scene = instanced_cubes()
    monkeypatch.setattr("raystream.scene.load.load", lambda name, **more: scene)
    rng = np.random.default_rng(2)
    origins = rng.uniform(-6.0, 6.0, (200, 3))
    given = {"origins": origins, "directions": rng.uniform(-4.0, 4.0, (200, 3)) - origins}
    np.savez(tmp_path / "rays.npz", **given)
    run("query", "cubes", "rays.npz", "-o", "hits.npz", f"--{kind}")
    found = arrays("hits.npz")
    assert set(found) == INSTANCES[kind]
    expected = getattr(rs.Tracer(scene), QUERIES[kind])(**given)
    for name, array in found.items():
        wanted = expected if kind in ("any", "count") else getattr(expected, name)
        np.testing.assert_array_equal(array, wanted)
        assert array.dtype == wanted.dtype
    if "instance_id" in found:
        assert len(np.unique(found["instance_id"])) > 6


@pytest.mark.parametrize("kind", ["first", "multi"])
def test_faces_are_the_files_unless_only_the_structure_is_saved(run, tmp_path, kind):
    (tmp_path / "faces.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 2 0 0\nv 2 1 0\nf 1 2 3 4\nf 2 5 6 3\n"
    )
    origins = [[0.6, 0.2, 1.0], [0.2, 0.6, 1.0], [1.6, 0.2, 1.0], [1.2, 0.6, 1.0], [3.0, 0.0, 1.0]]
    np.savez(tmp_path / "rays.npz", origins=origins, directions=[[0.0, 0.0, -1.0]])
    run("query", "faces.obj", "rays.npz", "-o", "hits.npz", f"--{kind}")
    found = arrays("hits.npz")
    miss = [-1] if kind == "first" else []
    assert found["prim_id"].tolist() == [0, 1, 2, 3, *miss]
    assert found["face_id"].tolist() == [0, 0, 1, 1, *miss]
    rs.Tracer(rs.load("faces.obj")).save("saved.npz")
    run("query", "saved.npz", "rays.npz", "-o", "hits.npz", f"--{kind}")
    assert set(arrays("hits.npz")) == set(found) - {"face_id"}


def instanced_cubes() -> rs.Scene:
    vertices, faces = cube()
    two = rs.Scene([rs.Mesh(vertices, faces), rs.Mesh(vertices + 2.0, faces)])
    return rs.Scene.instances(two, random_transforms(np.random.default_rng(1), 8, 4.0))


def test_saved_structure_is_traced(run, tmp_path, square, rays):
    rs.Tracer(rs.load(square)).save(tmp_path / "saved.npz")
    figures = run("query", "saved.npz", rays, "-o", "hits.npz", "--json").figures
    assert (figures["structure"], figures["triangles"]) == ("bvh", 2)
    assert (figures["rays"], figures["rays_hit"], figures["hits"]) == (4, 2, 2)
    assert figures["invalid_rays"] == 1


def test_no_rays(run, square, tmp_path):
    np.savez(tmp_path / "none.npz", origins=np.zeros((0, 3)), directions=np.zeros((0, 3)))
    assert run("query", square, "none.npz", "-o", "hits.npz", "--json").figures["rays"] == 0
    assert arrays("hits.npz")["t"].shape == (0,)


ZEROS = np.zeros((4, 3))

BAD_RAYS = {
    "no directions": {"origins": ZEROS},
    "another array": {"origins": ZEROS, "directions": ZEROS, "tmax": np.ones(4)},
    "other shapes": {"origins": ZEROS, "directions": np.zeros((3, 3))},
    "no vectors": {"origins": np.zeros((4, 2)), "directions": np.zeros((4, 2))},
    "wrong t_max": {"origins": ZEROS, "directions": ZEROS, "t_max": np.ones(3)},
    "booleans": {"origins": ZEROS, "directions": ZEROS > 0},
    "complex numbers": {"origins": ZEROS, "directions": ZEROS * 1j},
    "objects": {"origins": ZEROS, "directions": np.full((4, 3), None)},
}


@pytest.mark.parametrize("kind", BAD_RAYS)
def test_bad_rays_are_refused_in_one_line(run, square, tmp_path, kind):
    np.savez(tmp_path / "rays.npz", **BAD_RAYS[kind])
    assert run("query", square, "rays.npz", "-o", "h.npz").complaint.startswith("rays.npz: ")
    assert not (tmp_path / "h.npz").exists()


@pytest.mark.parametrize("content", [None, b"", b"no archive", "half"])
def test_file_that_holds_no_rays_is_refused_in_one_line(run, square, rays, content):
    path = rays.with_name("bad.npz")
    if content == "half":
        content = rays.read_bytes()[: rays.stat().st_size // 2]
    if content is not None:
        path.write_bytes(content)
    assert run("query", square, "bad.npz", "-o", "h.npz").complaint.startswith("bad.npz: ")


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--any", "--multi"], "--any and --multi"),
        (["--max-hits", "3"], "--max-hits"),
        (["--count", "--max-hits", "3"], "--max-hits"),
        (["--multi", "--max-hits", "-1"], "--max-hits"),
        (["--first", "--crossings", "surfaces"], "--crossings"),
        (["--count", "--crossings", "edges"], "--crossings"),
        (["-o", "hits.csv"], "hits.csv"),
        (["-o", "nowhere/hits.npz"], "nowhere"),
        (["-o", "rays.npz"], "rays.npz: is an input"),
    ],
)
def test_bad_option_is_refused_in_one_line(run, square, rays, arguments, named):
    before = rays.read_bytes()
    assert named in run("query", square, rays, "-o", "hits.npz", *arguments).complaint
    assert rays.read_bytes() == before


@pytest.mark.ci
@pytest.mark.skipif(not hasattr(os, "openpty"), reason="needs a terminal")
def test_ctrl_c_ends_a_long_query_in_one_line(run, tmp_path, environment):
    """Billions of triangle tests; the bar on the terminal tells when they have begun."""
    directions = np.random.default_rng(7).normal(size=(1_000_000, 3))
    np.savez(tmp_path / "many.npz", origins=np.zeros((1, 3)), directions=directions)
    np.savez(tmp_path / "few.npz", origins=np.zeros((1, 3)), directions=directions[:1000])
    command = ("query", "robots:50000", "many.npz", "-o", "hits.npz", "--structure", "brute")
    run("query", "cornell", "few.npz", "-o", "few_hits.npz", "--structure", "brute")  # compiles
    before = set(tmp_path.iterdir())

    reader, terminal = os.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "raystream", *command],
        env={**environment, "TERM": "xterm", "COLUMNS": "80"},
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=terminal,
    )
    os.close(terminal)
    try:
        shown = read_until(reader, b"%")
        assert b"tracing" in shown
        process.send_signal(signal.SIGINT)
        sent = time.monotonic()
        shown = read_until(reader, b"interrupted")
        out, _ = process.communicate(timeout=30)
    finally:
        process.kill()
        process.wait()
        os.close(reader)
    assert time.monotonic() - sent < 10
    assert process.returncode == 130
    assert out == b""
    assert b"Traceback" not in shown
    assert set(tmp_path.iterdir()) == before


def read_until(reader: int, text: bytes) -> bytes:
    shown = b""
    while text not in shown:
        try:
            more = os.read(reader, 4096)
        except OSError:  # what Linux says when the other end is closed
            more = b""
        assert more, f"the process ended without {text!r}: {shown[-2000:]!r}"
        shown += more
    return shown
