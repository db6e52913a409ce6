"""Reports: pages, Markdown and JSON of the same results."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from extras import need
from raystream_lab import (
    About,
    Claim,
    Experiment,
    Outcome,
    Plot,
    ReportImage,
    Result,
    Series,
    Table,
)
from raystream_lab.report import as_html, as_markdown, write_report

EVIL = '</script><b onclick="x()">&|`code`'


@pytest.fixture
def about() -> About:
    machine = {
        "cpu": "a <processor>",
        "threads": 2,
        "cores": 2,
        "memory": 2**34,
        "system": "Linux",
        "python": "3.11",
        "numpy": "2.0",
        "numba": "0.68",
    }
    command = "raystream lab purcell foley --size 64 -o out"
    return About(command, machine, "1.0", "abc", "2026-01-01", 3, True)


@pytest.fixture
def outcomes(tmp_path: Path) -> list[Outcome]:
    image = tmp_path / "scene.png"
    Image.fromarray(np.zeros((4, 4, 3), np.uint8)).save(image)
    result = Result(
        tables=[Table.of("t-1", EVIL, ["what", "number"], [[EVIL, 1.5], ["none", None]], EVIL)],
        plots=[
            Plot("p-1", "Lines", "x", "y", [Series("a", [1, 2, 3], [1.0, None, 3.0])], log_x=True),
            Plot("p-2", "Bars", "", "y", [Series("a", ["u", "v"], [1.0, 2.0])] * 2, "stacked"),
            Plot("p-3", "Beside", "", "y", [Series("a", ["u", "v"], [1.0, 2.0])] * 2, "bars"),
        ],
        claims=[Claim.judged(EVIL, "Purcell 2002", {"a": True, "b": False}, "evidence")],
        images=[ReportImage("scene", image)],
        notes=["left out: x"],
    )
    return [Outcome(Experiment("purcell-what", "What <it> is", "nowhere.x"), result)]


class Checker(HTMLParser):
    """Collects tags, and whether they close."""

    VOID = ("meta", "img", "br", "link", "input")

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.sources: list[str] = []
        self.bold: list[dict[str, str | None]] = []

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        given = dict(attributes)
        self.sources += [given[key] or "" for key in ("src", "href") if key in given]
        if tag == "b":
            self.bold.append(given)
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_page_is_whole_and_safe(about: About, outcomes: list[Outcome], tmp_path: Path) -> None:
    page = as_html(outcomes, about, {"p-1": tmp_path / "scene.png"})
    checker = Checker()
    checker.feed(page)
    assert checker.open == []
    assert checker.sources
    assert all(one.startswith(("#", "data:image/png")) for one in checker.sources)
    assert all("onclick" not in one for one in checker.bold)
    assert "<script" not in page
    assert "raystream lab purcell --only what --size 64 -o out" in page
    assert "<td class=part>holds in 1 of 2</td>" in page
    assert "a &lt;processor&gt;" in page
    assert "3 measurements were reused" in page


@pytest.mark.parametrize(
    ("verdict", "cell"),
    [
        ("holds", "<td class=holds>holds</td>"),
        ("holds in 11 of 12", "<td class=part>holds in 11 of 12</td>"),
        ("does not hold (0 of 12)", "<td class=not>does not hold (0 of 12)</td>"),
        ("not measured", "<td>not measured</td>"),
        ("holds in some", "<td>holds in some</td>"),
    ],
)
def test_verdicts_have_a_colour(about: About, verdict: str, cell: str) -> None:
    result = Result(claims=[Claim("claim", "source", verdict, "holds in 1 of 2 scenes")])
    page = as_html([Outcome(Experiment("purcell-x", "X", "nowhere.x"), result)], about, {})
    assert cell in page
    assert "<td>holds in 1 of 2 scenes</td>" in page


def test_markdown_tables_keep_their_columns(about: About, outcomes: list[Outcome]) -> None:
    text = as_markdown(outcomes, about, ["p-1"])
    rows = [line for line in text.splitlines() if line.startswith("|")]
    table = rows[rows.index("| what | number |") :]
    assert table[1] == "| --- | ---: |"
    assert len(re.findall(r"(?<!\\)\|", table[2])) == 3
    assert table[3] == "| none | – |"
    assert "plots/p-1.png" in text
    assert "plots/p-2.png" not in text


def test_report_is_written_with_plots(
    about: About, outcomes: list[Outcome], tmp_path: Path
) -> None:
    folder = tmp_path / "report"
    folder.mkdir()
    files = write_report(folder, outcomes, about)
    assert [one.name for one in files] == ["report.html", "report.md", "report.json"]
    content = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    table = content["experiments"]["purcell-what"]["tables"][0]
    assert table["rows"] == [{"what": EVIL, "number": 1.5}, {"what": "none", "number": None}]
    need("matplotlib")
    for name in ("p-1", "p-2", "p-3"):
        with Image.open(folder / "plots" / f"{name}.png") as image:
            assert image.width > 300
            assert len(np.unique(np.asarray(image.convert("RGB")).reshape(-1, 3), axis=0)) > 3
