"""Figures derived from measurements, by cases computed by hand."""

from __future__ import annotations

from raystream.bench.results import SetResult


def test_the_median_of_the_better_mode_counts():
    seconds = {
        "own": {"": [1.0, 1.0, 7.0]},
        "peer": {"one by one": [3.0, 0.5, 9.0], "together": [2.0, 2.0, 2.5]},
        "slow": {"": [4.0]},
    }
    rays = SetResult("primary", "first", 6_000_000, seconds=seconds)
    assert rays.best_mode("peer") == "together"
    assert rays.speed("peer") == 3.0
    assert rays.best_peer(["slow", "peer", "absent"]) == "peer"
    assert rays.ratio("own", "peer") == 2.0
    assert rays.ratio("peer", "own") == 0.5


def test_who_took_no_part_has_no_figures():
    rays = SetResult("primary", "first", 100, seconds={"own": {"": [1.0]}})
    assert rays.speed("absent") is None
    assert rays.best_peer(["absent"]) is None
    assert rays.ratio("own", None) is None
    assert rays.ratio("own", "absent") is None
    assert rays.ratio("absent", "own") is None
