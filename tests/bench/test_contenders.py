"""Each installed peer gives raystream's answers, in a separate process."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys

import numpy as np
import pytest

import raystream as rs
from conftest import child_environment
from instanced import random_transforms
from meshes import icosphere
from raystream.bench.contender_process import ContenderError, ContenderProcess
from raystream.bench.contenders import PEERS, Entry
from raystream.bench.contenders.base import Geometry, Rays
from raystream.bench.ray_sets import RAY_SETS
from raystream.bench.runner import geometry_of
from raystream.bench.worker import OUTCOME, load_geometry, save_geometry, save_rays

#: Peers with tests that are not watertight, or with looser boxes, may differ more.
LIMITS = dict.fromkeys(("open3d", "embreex", "embreex-robust", "fcpw"), 2e-3)
LIMITS |= {"mitsuba": 2e-3, "mitsuba-robust": 2e-3, "warp": 2e-2, "libigl": 1e-9}

#: Peers that find all hits, and closest points.
MULTI_PEERS = ("open3d", "embreex", "embreex-robust")
POINT_PEERS = tuple(name for name, peer in PEERS.items() if peer.for_points)

#: Spheres and cubes touch the floor: where two surfaces are in one place, both peers that find
#: all hits lose one of the two.
MULTI_LIMIT = 0.1


RAY_PEERS = tuple(name for name, peer in PEERS.items() if peer.for_rays)


def need_peer(name):
    """Skip the test if a peer is not installed: no extra for tests has them."""
    missing = [
        package for package in PEERS[name].packages if importlib.util.find_spec(package) is None
    ]
    if missing:
        pytest.skip(f"needs {', '.join(missing)}: {PEERS[name].install_hint}")


@pytest.mark.parametrize("name", PEERS)
def test_peer_agrees(name):
    need_peer(name)
    command = (
        "bench spheres:3000 --width 64 --height 48 --repeats 1 --json --threads 1 "
        f"--sets {','.join(RAY_SETS)} --peers {name}"
    )
    done = subprocess.run(
        [sys.executable, "-m", "raystream", *command.split()],
        env=child_environment(),
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    figures = json.loads(done.stdout)
    if name in figures["absent"]:
        pytest.skip(f"{name}: {figures['absent'][name]}")
    (scene,) = figures["scenes"]
    assert not scene["failures"]
    for rays in scene["sets"]:
        known = {"multi": MULTI_PEERS, "closest": POINT_PEERS}.get(rays["query"], RAY_PEERS)
        if name not in known:
            assert rays["failures"] == {name: "does not support this query"}
            continue
        assert rays["failures"] == {}
        limit = MULTI_LIMIT if rays["query"] == "multi" else LIMITS[name]
        assert rays["agreement"][name]["differing"] < limit, rays["name"]
        assert rays["figures"]["mrays_per_second"][name] > 0.0


@pytest.mark.parametrize("name", ["raystream", "open3d", "embreex-robust", "mitsuba-robust"])
def test_watertight_contenders_let_no_ray_through_an_edge(name, tmp_path):
    """Rays at the middles of a sphere's edges, from within and from afar."""
    if name != "raystream":
        need_peer(name)
    vertices, faces = icosphere(4)
    vertices, faces = vertices.astype(np.float32), faces.astype(np.int32)
    save_geometry(tmp_path, Geometry(vertices, faces))
    middles = 0.5 * (vertices[faces[:, 0]] + vertices[faces[:, 1]]).astype(np.float64)
    origins = np.concatenate([np.full_like(middles, 0.1), 7.0 * middles + [0.1, 0.2, 0.3]])
    directions = np.concatenate([middles, middles]) - origins
    save_rays(tmp_path, Rays(origins.astype(np.float32), directions.astype(np.float32), np.inf))
    try:
        process = ContenderProcess(Entry("robust", name, {}), 1)
    except ContenderError as error:
        pytest.skip(str(error))
    try:
        assert process.about["watertight"]
        process.ask("build", folder=str(tmp_path), measured=False)
        for mode in process.about["modes"]:
            folder = str(tmp_path)
            process.ask("trace", folder=folder, query="first", mode=mode, keep=folder)
            assert np.isfinite(np.load(tmp_path / OUTCOME)).all(), mode
    finally:
        process.close()


def placed_scene() -> rs.Scene:
    """Two kinds of objects, of more than one mesh, mirrored and scaled by axis."""
    ball = rs.Mesh(*icosphere(3))
    objects = [[ball, ball.moved(ball.vertices + [3.0, 0.0, 0.0])], [rs.Mesh(*icosphere(2))]]
    rng = np.random.default_rng(5)
    return rs.Scene.instances(objects, random_transforms(rng, 30), rng.integers(0, 2, 30))


@pytest.mark.parametrize("name", ["raystream", *PEERS])
def test_scenes_of_instances(name, tmp_path):
    """Contenders that have instances find the same hits, and the others say that they have none."""
    if name != "raystream":
        need_peer(name)
    scene = placed_scene()
    geometry = geometry_of(scene)
    save_geometry(tmp_path, geometry)
    loaded = load_geometry(tmp_path)
    for objects in (geometry.objects(), loaded.objects()):
        counts = [(len(vertices), len(faces)) for vertices, faces in objects]
        assert counts == [(1284, 2560), (162, 320)]
    assert geometry.triangle_count == loaded.triangle_count
    assert loaded.triangle_count == scene.flattened().triangle_count
    rng = np.random.default_rng(6)
    origins = rng.uniform(-20.0, 20.0, (3000, 3)).astype(np.float32)
    directions = (rng.uniform(-10.0, 10.0, (3000, 3)) - origins).astype(np.float32)
    save_rays(tmp_path, Rays(origins, directions, np.inf))
    wanted = rs.Tracer(scene).first_hit(origins, directions).t
    assert 500 < np.isfinite(wanted).sum() < 2500
    try:
        process = ContenderProcess(Entry(name, name, {}), 1)
    except ContenderError as error:
        pytest.skip(str(error))
    folder = str(tmp_path)
    try:
        if name not in ("raystream", "mitsuba", "mitsuba-robust"):
            with pytest.raises(ContenderError, match="no instances"):
                process.ask("build", folder=folder, measured=False)
            return
        process.ask("build", folder=folder, measured=False)
        process.ask(
            "trace", folder=folder, query="first", mode=process.about["modes"][0], keep=folder
        )
        found = np.load(tmp_path / OUTCOME)
        assert (np.isfinite(found) == np.isfinite(wanted)).mean() > 0.998
        both = np.isfinite(found) & np.isfinite(wanted)
        assert (np.abs(found[both] - wanted[both]) < 1e-4).mean() > 0.998
    finally:
        process.close()
