"""A user's code under ``mypy --strict``, against the package as it is installed."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import raystream
from extras import need

need("mypy")

pytestmark = pytest.mark.exhaustive

CODE = """
from __future__ import annotations

from typing import assert_type

import numpy as np
from numpy.typing import NDArray

import raystream as rs

mesh = rs.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
light = rs.PointLight((1.0, 2.0, 3.0), (10.0, 10.0, 10.0))
scene = rs.Scene([mesh], materials=[rs.Material(diffuse=(0.5, 0.5, 0.5))], lights=[light])
assert_type(rs.load("cornell"), rs.Scene)
tracer = rs.Tracer(scene, rs.Bvh(), rs.Cpu())
rs.Tracer(scene, "kdtree")

origins: NDArray[np.float32] = np.zeros((10, 3), np.float32)
directions = np.ones((10, 3), np.float32)
hits = tracer.first_hit(origins, directions, t_min=0.1)
assert_type(hits, rs.Hits)
assert_type(tracer.multi_hit(origins, directions, max_hits=4), rs.MultiHits)
assert_type(tracer.any_hit(origins, directions), NDArray[np.bool_])
assert_type(tracer.closest_point(origins), rs.ClosestPoints)

camera = rs.Camera(eye=(0.0, 0.0, 5.0), look_at=(0.0, 0.0, 0.0), fov=30.0)
image = rs.render(scene, mode="raycast", size=(64, 48), camera=camera)
assert_type(image, rs.Image)
image.save("picture.png")
assert_type(rs.export_page(tracer, "page.html", camera=camera, size=(64, 48)), int)

tracer.first_hit(origins)  # wrong
rs.Bvh(no_such_option=1)  # wrong
rs.Camera("here", (0.0, 0.0, 0.0))  # wrong
"""


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """Give what mypy prints of CODE, and of the type of each public name."""
    folder = tmp_path_factory.mktemp("user")
    names = "".join(f"reveal_type(rs.{name})\n" for name in raystream.__all__)
    (folder / "user.py").write_text(CODE, encoding="utf-8")
    (folder / "names.py").write_text(f"import raystream as rs\n{names}", encoding="utf-8")
    # mypy takes folders of PYTHONPATH for installed packages: without py.typed it refuses them.
    installed = {"PYTHONPATH": str(Path(raystream.__file__).parents[1])}
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file=", "user.py", "names.py"]
    done = subprocess.run(
        command, cwd=folder, env={**os.environ, **installed}, capture_output=True, text=True
    )
    assert done.stderr == ""
    return done.stdout


def test_a_users_code_has_no_errors_but_its_own(report):
    wrong = [i for i, line in enumerate(CODE.splitlines(), 1) if line.endswith("# wrong")]
    errors = re.findall(r"^user\.py:(\d+): error: .*", report, re.MULTILINE)
    assert [int(number) for number in errors] == wrong, report


def test_public_names_have_types(report):
    revealed = re.findall(r'^names\.py:(\d+): note: Revealed type is "(.*)"$', report, re.M)
    assert len(revealed) == len(raystream.__all__)
    untyped = [raystream.__all__[int(line) - 2] for line, kind in revealed if kind == "Any"]
    assert untyped == []
