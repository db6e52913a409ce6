"""Every example runs in an empty folder, and writes the files that it names."""

from __future__ import annotations

import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from conftest import child_environment
from extras import need

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"

#: Packages with which examples do more.
PACKAGES = {
    "cluster": ("dask", "distributed"),
    "jax_pose": ("jax",),
    "lidar_scan": ("matplotlib",),
    "picking": ("matplotlib",),
    "stackless": ("matplotlib",),
    "torch_terrain": ("torch",),
}


#: Starts processes that import it; and the first one that a visitor runs.
ALONE = ("cluster", "first_query")


@pytest.mark.parametrize("example", sorted(EXAMPLES.glob("*/*.py")), ids=lambda path: path.stem)
def test_example(example, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    for _ in range(2 if example.stem == "save_and_load" else 1):
        out = run_alone(example) if example.stem in ALONE else run_here(example, monkeypatch, capfd)
        assert out
    for word in out.replace(":", " ").replace(",", " ").split():
        if word.endswith((".png", ".npy", ".npz")):
            assert (tmp_path / word).stat().st_size > 0
    need(*PACKAGES.get(example.stem, ()))


def run_here(example, monkeypatch, capfd):
    """Its output, when run in this process, which has already imported raystream."""
    monkeypatch.setattr(sys, "argv", [str(example)])
    runpy.run_path(str(example), run_name="__main__")
    out, err = capfd.readouterr()
    assert not err
    return out


def run_alone(example):
    run = subprocess.run(
        [sys.executable, example],
        env=child_environment(),
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    assert not run.stderr
    return run.stdout
