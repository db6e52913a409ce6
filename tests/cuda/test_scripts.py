"""The scripts that check and measure a GPU, run on the available device."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest

from extras import need

need("numba_cuda")

from bench.test_scripts import script
from raystream.cuda import ray_order
from raystream.jit.cuda import is_simulated


def test_speed(gpu, monkeypatch, tmp_path, capsys):
    speed = script("cuda_speed")
    kept = tmp_path / "speed.json"
    ours = "--ours grid --ours nothing --ours grid:rays_at_once=9"
    asked = f"cornell --size 4x3 --per-hit 2 --repeats 1 --part 16 {ours} --json {kept}"
    monkeypatch.setattr(sys, "argv", ["cuda_speed.py", *asked.split()])
    monkeypatch.setattr(speed, "WARP", {})
    assert speed.main() == 0
    (scene,) = json.loads(kept.read_text())["scenes"]
    assert list(scene["absent"]) == ["nothing"]
    assert [(row["set"], row["contender"]) for row in scene["rows"]] == [
        (name, label)
        for name in ("primary", "ao", "diffuse")
        for label in ("grid", "grid:rays_at_once=9")
    ]
    primary, ao, diffuse = scene["rows"][::2]
    assert (primary["rays"], primary["other_bits_than_cpu"]) == (12, 0)
    assert ao["rays"] == diffuse["rays"] <= 24
    assert all(row["differing"] == 0.0 for row in scene["rows"])
    assert len(capsys.readouterr().out.splitlines()) == 7


def test_a_small_scene_has_the_processor_s_bits(gpu, capsys):
    assert script("cuda_check").small(tiny=True) == 0
    assert "0 queries with other bits than the CPU's" in capsys.readouterr().out


def _sort(_gpu, keys, values, _bits, **_options):
    order = np.argsort(keys.host(), kind="stable")
    keys.fill(keys.host()[order])
    values.fill(values.host()[order])
    return keys, values


@pytest.mark.parametrize(("asked", "side"), [("counts", 32), ("rates", 8)], ids=["counts", "rates"])
def test_coherence(gpu, monkeypatch, tmp_path, capsys, asked, side):
    kept = tmp_path / "coherence.json"
    if is_simulated():  # whose own sort takes seconds
        monkeypatch.setattr(ray_order, "sort_pairs", _sort)
    more = f"--{asked} --way grid --way grid:order=sorted --repeats 1 --json {kept}"
    given = f"cornell --size {side}x{side} --per-hit 1 {more}"
    monkeypatch.setattr(sys, "argv", ["cuda_coherence.py", *given.split()])
    assert script("cuda_coherence").main() == 0
    found = json.loads(kept.read_text())
    ((scene,), none) = found[asked], found["rates" if asked == "counts" else "counts"]
    assert none == []
    rows = scene["rows"]
    assert len(capsys.readouterr().out.splitlines()) == 1 + len(rows)
    if asked == "rates":
        ways = [(row["rays_come"], row["contender"]) for row in rows]
        assert ways == 3 * [
            *(("given", "grid"), ("given", "grid:order=sorted")),
            *(("shuffled", "grid"), ("shuffled", "grid:order=sorted")),
        ]
        assert all(row["differing"] == 0.0 for row in rows)
        assert [row["other_bits_than_cpu"] for row in rows[:4]] == [0, None] * 2
        return
    assert [row["order"] for row in rows] == 3 * ["given", "shuffled", "sorted"]
    for row in rows:
        assert row["rays"] <= side**2
        assert 1.0 / 32.0 <= row["lanes"] <= 1.0
        assert row["lanes"] <= row["refilled"] <= 1.0
        assert 1.0 <= row["longest"] <= row["all"]
    given, shuffled, ordered = rows[:3]
    assert (given["nodes"], given["tests"]) == (shuffled["nodes"], shuffled["tests"])
    assert min(given["lanes"], ordered["lanes"]) > shuffled["lanes"]
    assert max(given["all"], ordered["all"]) < shuffled["all"]
