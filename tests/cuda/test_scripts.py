"""The scripts that check and measure a GPU, run on the available device."""

from __future__ import annotations

import json
import sys

from extras import need

need("numba_cuda")

from bench.test_scripts import script


def test_speed(gpu, monkeypatch, tmp_path, capsys):
    speed = script("cuda_speed")
    kept = tmp_path / "speed.json"
    ours = "--ours grid --ours nothing --ours grid:rays_at_once=9"
    asked = f"cornell --size 4x3 --per-hit 2 --repeats 1 --shuffled {ours} --json {kept}"
    monkeypatch.setattr(sys, "argv", ["cuda_speed.py", *asked.split()])
    monkeypatch.setattr(speed, "WARP", {})
    assert speed.main() == 0
    (scene,) = json.loads(kept.read_text())["scenes"]
    assert list(scene["absent"]) == ["nothing"]
    assert [(row["set"], row["rays_come"], row["contender"]) for row in scene["rows"]] == [
        (name, order, label)
        for name in ("primary", "ao", "diffuse")
        for order in ("given", "shuffled")
        for label in ("grid", "grid:rays_at_once=9")
    ]
    primary, ao, diffuse = scene["rows"][::4]
    assert (primary["rays"], primary["other_bits_than_cpu"]) == (12, 0)
    assert scene["rows"][2]["other_bits_than_cpu"] == 0
    assert ao["rays"] == diffuse["rays"] <= 24
    assert all(row["differing"] == 0.0 for row in scene["rows"])
    assert len(capsys.readouterr().out.splitlines()) == 13


def test_a_small_scene_has_the_processor_s_bits(gpu, capsys):
    assert script("cuda_check").small(tiny=True) == 0
    assert "0 queries with different bits than the CPU's" in capsys.readouterr().out
