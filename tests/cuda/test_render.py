"""Images and the command line on CUDA: the CPU's bits."""

from __future__ import annotations

import json

import numpy as np
import pytest

from extras import need

need("numba_cuda")

import raystream as rs
from conftest import assert_same_bits, leave_out_first_use
from raystream.cli import main

#: First hits; any hits between surfaces and lights; all hits; and both of many bounces.
MODES = {"raycast": {}, "shadow": {}, "xray": {}, "path": {"samples": 1, "max_bounces": 2}}


@pytest.fixture(scope="module")
def scene():
    return rs.load("cornell")


@pytest.mark.parametrize("mode", MODES)
def test_pictures_are_the_processor_s(gpu, scene, mode):
    ours, theirs = (
        rs.render(rs.Tracer(scene, "grid", device), mode, size=(8, 6), **MODES[mode]).pixels
        for device in ("cuda", "cpu")
    )
    assert_same_bits(ours, theirs)
    assert theirs.std() > 0.0


@pytest.fixture
def run(capsys, tmp_path, monkeypatch):
    """Run the command line in this process; returns what it printed as JSON."""
    monkeypatch.chdir(tmp_path)
    leave_out_first_use(monkeypatch)

    def call(*arguments):
        capsys.readouterr()
        with pytest.raises(SystemExit) as end:
            main([*arguments, "--json"])
        out, err = capsys.readouterr()
        assert (end.value.code, err) == (0, "")
        return json.loads(out)

    return call


def test_the_command_line_renders_and_asks(gpu, run):
    chosen = "cornell", "--structure", "grid"
    for device in ("cpu", "cuda"):
        on = "--device", device, *(["--gpu", "0"] if device == "cuda" else [])
        size = "--mode", "shadow", "--size", "8x6"
        figures = run("render", *chosen, *on, *size, "-o", f"{device}.png")
        assert (figures["device"], figures["machine"]) == (device, "branching")
        rays = np.array([[278.0, 273, -800], [-900, 0, 0]]), np.array([0.0, 0, 1])
        np.savez("rays.npz", origins=rays[0], directions=rays[1])
        figures = run("query", *chosen[:1], "rays.npz", *chosen[1:], *on, "-o", f"{device}.npz")
        assert (figures["device"], figures["rays_hit"]) == (device, 1)
    ours, theirs = (rs.Image.load(f"{device}.png").pixels for device in ("cuda", "cpu"))
    assert_same_bits(ours, theirs)
    with np.load("cuda.npz") as ours, np.load("cpu.npz") as theirs:
        for name in theirs.files:
            assert_same_bits(ours[name], theirs[name])


def test_the_device_is_listed(gpu, run):
    (first, *_) = run("info", "--devices")["cuda"]["gpus"]
    assert first["name"] == gpu.name
    assert first["capability"] == ".".join(map(str, gpu.capability))
    assert first["error"] is None
