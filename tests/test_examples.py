"""Every example runs, in an empty folder, and writes what it says."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from conftest import child_environment
from extras import need

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"

#: What examples do more of where these packages are.
PACKAGES = {
    "cluster": ("dask", "distributed"),
    "lidar_scan": ("matplotlib",),
    "xray_attenuation": ("matplotlib",),
}


@pytest.mark.parametrize("example", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_example(example, tmp_path):
    for _ in range(2 if example.stem == "save_and_load" else 1):
        run = subprocess.run(
            [sys.executable, example],
            cwd=tmp_path,
            env=child_environment(),
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
        assert run.returncode == 0, run.stderr
        assert not run.stderr
        assert run.stdout
    for word in run.stdout.replace(":", " ").replace(",", " ").split():
        if word.endswith((".png", ".npy", ".npz")):
            assert (tmp_path / word).stat().st_size > 0
    need(*PACKAGES.get(example.stem, ()))
