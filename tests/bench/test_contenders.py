"""Each installed peer gives raystream's answers, in a separate process."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys

import pytest

from conftest import child_environment
from raystream.bench.contenders import PEERS

#: Peers with tests that are not watertight, or with looser boxes, may differ more.
LIMITS = {"open3d": 2e-3, "embreex": 2e-3, "mitsuba": 2e-3, "warp": 2e-2, "fcpw": 2e-2}

#: Spheres and cubes touch the floor: where two surfaces are in one place, both peers that find
#: all hits lose one of the two.
MULTI_LIMIT = 0.1


@pytest.mark.parametrize("name", PEERS)
def test_peer_agrees(name):
    missing = [
        package for package in PEERS[name].packages if importlib.util.find_spec(package) is None
    ]
    if missing:
        pytest.skip(f"needs {', '.join(missing)}: {PEERS[name].install_hint}")
    command = (
        "bench spheres:3000 --width 64 --height 48 --repeats 1 --no-memory --json --threads 1 "
        f"--sets primary,shadow,ao,bounce,random,multi,random_multi --peers {name}"
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
        if rays["query"] == "multi" and name not in ("open3d", "embreex"):
            assert rays["failures"] == {name: "does not support this query"}
            continue
        assert rays["failures"] == {}
        limit = MULTI_LIMIT if rays["query"] == "multi" else LIMITS[name]
        assert rays["agreement"][name]["differing"] < limit, rays["set"]
        assert rays["mrays_per_second"][name] > 0.0
