"""Tables and the chart, from results made by hand and from the stored ones."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from bench.made_results import made
from raystream.bench.chart import chart_text, draw_chart, draw_speeds
from raystream.bench.report import REPORT_SUFFIXES, goal_table, make_tables, write_report
from raystream.bench.results import read_result

SVG = "{http://www.w3.org/2000/svg}"
STORED = Path(__file__).resolve().parents[2] / "docs" / "performance"


def texts(root):
    return [one.text for one in root.iter(f"{SVG}text")]


def test_the_chart_has_a_dot_for_each_scene_and_set():
    result = made(**{"a & b": {"ao": 1.8, "image": 0.9}, "b": {"ao": 1.5}})
    root = ET.fromstring(draw_chart(result))
    found = texts(root)
    for text in ("a & b", "b", "median", "1.80", "0.90", "1.50", "goal 1.75, least 1.2"):
        assert text in found
    dots = list(root.iter(f"{SVG}circle"))
    assert len(dots) == 3 + 2 + 3  # ratios, medians, legend
    assert chart_text(result) == root.get("aria-label")
    assert "ambient occlusion 1.65" in root.get("aria-label")


def test_dots_are_where_their_ratios_are():
    root = ET.fromstring(draw_chart(made(a={"ao": 0.5}, b={"ao": 1.0}, c={"ao": 2.0})))
    low, middle, high, _, *_ = (float(dot.get("cx")) for dot in root.iter(f"{SVG}circle"))
    assert high - middle == pytest.approx(middle - low, abs=0.11)
    rules = [float(line.get("x1")) for line in root.iter(f"{SVG}line")]
    assert any(abs(x - middle) < 0.11 for x in rules)  # the line at 1
    colors = [dot.get("fill") for dot in root.iter(f"{SVG}circle")][:3]
    assert len(set(colors)) == 3


def test_a_chart_of_nothing():
    assert texts(ET.fromstring(draw_chart(made())))


def test_bars_are_as_long_as_speeds():
    result = made(a={"primary": 2.0}, b={"primary": 8.0}, c={"multi": 1.0})
    for rays in (one for scene in result.scenes for one in scene.sets):
        rays.seconds = {"raystream": rays.seconds["raystream"], "open3d": rays.seconds["best"]}
    root = ET.fromstring(draw_speeds(result))
    assert {"Camera rays, first hit", "Open3D", "0.2", "1.0"} <= set(texts(root))
    assert "Mitsuba" not in texts(root)  # took no part
    assert "Camera rays, first hit: raystream 1.0, Open3D 0.2" in root.get("aria-label")
    background, own, other, *_ = root.iter(f"{SVG}rect")
    assert background.get("fill") == "#ffffff"
    assert float(own.get("width")) == pytest.approx(4 * float(other.get("width")), abs=0.3)


def test_bars_of_nothing():
    assert texts(ET.fromstring(draw_speeds(made())))


def test_the_chart_of_speeds_is_current():
    drawn = draw_speeds(read_result(STORED / "result.json"))
    stored = (STORED.parent / "images" / "speed.svg").read_text(encoding="utf-8")
    assert stored == f"{drawn}\n", "run python docs/images/speed.py"


def test_goals_that_are_met_are_named():
    result = made(a={"ao": 1.8, "image": 2.5, "primary": 1.2}, b={"ao": 1.1, "image": 1.5})
    rows = {row[0]: row for row in goal_table(result).rows}
    assert rows["ambient occlusion"][5:] == ["b", "neither", "13.05", "9.90"]  # 9 times as fast
    assert rows["primary, (H, W, 3)"][5:7] == ["b", "both"]
    assert rows["primary, (N, 3)"][1:5] == ["1.20", "2", "1.20", "1.3"]


def test_reports_are_made_of_a_result(tmp_path):
    result = made(a={"ao": 1.8})
    for suffix in REPORT_SUFFIXES:
        path = tmp_path / f"report{suffix}"
        write_report(path, result)
        assert path.read_text().endswith("\n")
    assert "| ao | 1,000,000 | 1 | 0.556 |" in (tmp_path / "report.md").read_text()
    assert (tmp_path / "report.rst").read_text().count(".. list-table::") == 4
    ET.parse(tmp_path / "report.svg")


@pytest.mark.skipif(not STORED.is_dir(), reason="the results are not in an installed package")
def test_the_stored_results_can_be_reported():
    paths = sorted(STORED.glob("*.json"))
    assert paths
    for path in paths:
        result = read_result(path)
        assert make_tables(result)
        assert all(scene.is_complete for scene in result.scenes)
        for scene in result.scenes:
            for rays in scene.sets:
                assert 0.0 < result.share(rays) < 4.0
