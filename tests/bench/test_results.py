"""Figures derived from measurements, by cases computed by hand; and the stored form."""

from __future__ import annotations

import json

import pytest

from bench.made_results import made
from raystream.bench.goals import GOALS, judge
from raystream.bench.ray_sets import DEFAULT_SETS, RAY_SETS
from raystream.bench.report import roofline_table, speed_tables
from raystream.bench.results import SetResult, read_result, write_result
from raystream.bench.roofline import Counts


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


def test_goals():
    assert tuple(GOALS)[: len(DEFAULT_SETS)] == DEFAULT_SETS
    assert all(RAY_SETS[name].query == "closest" for name in tuple(GOALS)[len(DEFAULT_SETS) :])
    result = made(a={"ao": 2.0, "image": 3.0}, b={"ao": 0.5, "image": 1.4}, c={"ao": 4.0})
    ao, image = judge(result)
    assert (ao.median, ao.least, ao.most, ao.worst_scene) == (2.0, 0.5, 4.0, "b")
    assert ao.meets_median
    assert not ao.meets_least
    assert image.median == pytest.approx(2.2)
    assert (image.meets_median, image.meets_least) == (True, False)
    (free,) = judge(made(a={"random_multi": 0.5}))
    assert free.goal is None
    assert free.meets_median
    assert free.meets_least


def test_the_roofline_of_a_set():
    result = made(a={"ao": 2.0})
    (rays,) = result.scenes[0].sets
    # 5 nodes, one and a half blocks without a hit, and a half with one: 5 + 3 + 5 ns.
    assert result.share(rays) == pytest.approx(1e6 / (1.0 / 13e-9))
    rays.counts = None
    assert result.share(rays) is None


def test_rays_that_need_no_test_have_no_share(tmp_path):
    result, path = made(a={"ao": 2.0}, b={"ao": 2.0}), tmp_path / "result.json"
    for scene in result.scenes:
        (rays,) = scene.sets
        rays.counts = Counts(0.0, 0.0, 0.0)
    assert result.share(rays) is None
    assert roofline_table(result).rows == []
    assert [table.rows[0][7] for table in speed_tables(result)] == ["–", "–"]
    write_result(path, result)
    assert read_result(path) == result
    result.scenes[0].sets[0].counts = Counts(5.0, 2.0, 0.5)
    (row,) = roofline_table(result).rows
    assert row[1:5] == ["5.0", "2.0", "0.5", "77"]


def test_the_stored_form_holds_everything(tmp_path):
    result, path = made(a={"ao": 2.0, "image": 3.0}, b={"ao": 1.1}), tmp_path / "result.json"
    write_result(path, result)
    assert read_result(path) == result
    stored = json.loads(path.read_text())
    ao = stored["scenes"][0]["sets"][0]
    assert ao["figures"]["ratio_to_best_peer"] == {"raystream": 2.0}
    assert ao["figures"]["best_peer"] == "best"
    assert ao["figures"]["ratio_to_best_watertight_peer"] == 18.0
    assert stored["scenes"][0]["builds"]["raystream"]["memory"] == {"kept": 100, "peak": 200}


@pytest.mark.parametrize("change", [{"schema": 0}, {"scenes": [{"scene": "a"}]}, {"peaks": 3}])
def test_what_is_no_result_is_refused(tmp_path, change):
    path = tmp_path / "result.json"
    path.write_text(json.dumps({**made().as_json(), **change}))
    with pytest.raises(ValueError, match="result"):
        read_result(path)
    path.write_text("[]")
    with pytest.raises(ValueError, match="schema"):
        read_result(path)
