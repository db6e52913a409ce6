"""``import raystream`` is cheap: modules that are not needed yet are not imported."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import raystream

LATER = (
    *("numba", "llvmlite", "trimesh", "PIL", "typer", "rich", "pooch", "OpenEXR", "scipy"),
    *("imageio_ffmpeg", "pyoidn", "torch", "jax", "xarray"),
)


def modules_after(statement: str) -> set[str]:
    """``sys.modules`` of a new interpreter after it ran the statement."""
    code = f"import sys\n{statement}\nprint(*sys.modules)"
    assert raystream.__file__ is not None
    source = str(Path(raystream.__file__).resolve().parents[1])
    path = os.pathsep.join(filter(None, [source, os.environ.get("PYTHONPATH")]))
    result = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert result.returncode == 0, result.stderr
    return set(result.stdout.split())


@pytest.mark.parametrize(
    "statement",
    [
        "import raystream",
        "import raystream as rs; rs.Scene.from_arrays([[0, 0, 0]], [[0, 0, 0]])",
        "import raystream as rs; rs.Bvh(), rs.Cuda(gpu=1), rs.Multipass(scheduler='naive')",
        "import raystream as rs; rs.Camera(eye=(0, 0, 1), look_at=(0, 0, 0)).rays(4, 3)",
    ],
    ids=["package", "scene", "options", "camera"],
)
def test_import_brings_in_only_what_it_needs(statement: str) -> None:
    packages = {name.partition(".")[0] for name in modules_after(statement)}
    assert "raystream" in packages
    assert not packages & set(LATER)


def test_branching_brings_in_no_other_machine() -> None:
    triangle = "[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]"
    tracer = f"import raystream as rs; tracer = rs.Tracer(rs.Scene.from_arrays({triangle}))"
    modules = modules_after(f"{tracer}; tracer.first_hit([0, 0, 1], [0, 0, -1])")
    assert "raystream.machines.branching" in modules
    late = ("raystream.streams", "raystream.machines.multipass", "raystream.machines.counters")
    assert not modules & set(late)
