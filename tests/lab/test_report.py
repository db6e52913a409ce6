"""Reports: pages as Markdown and HTML, and JSON, of the same results."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from raystream.core.errors import RaystreamError
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
from raystream_lab.report import as_pages, build_html, write_report

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


def page_of(outcomes: list[Outcome], about: About, name: str, *arguments: Any) -> str:
    return dict(as_pages(outcomes, about, *arguments))[name]


def test_index_counts_the_verdicts(about: About, outcomes: list[Outcome]) -> None:
    text = page_of(outcomes, about, "index")
    assert "| Purcell 2002 | 1 | 0 | 1 | 0 | 0 |" in text
    assert "](purcell.md)" in text
    assert "3 measurements were reused" in text
    assert "a &lt;processor>" in text


@pytest.mark.parametrize(
    ("verdict", "counts"),
    [
        ("holds", "1 | 0 | 0 | 0"),
        ("holds in 11 of 12", "0 | 1 | 0 | 0"),
        ("does not hold (0 of 12)", "0 | 0 | 1 | 0"),
        ("not measured", "0 | 0 | 0 | 1"),
    ],
)
def test_verdicts_have_a_group(about: About, verdict: str, counts: str) -> None:
    result = Result(claims=[Claim("claim", "source", verdict, "holds in 1 of 2 scenes")])
    outcomes = [Outcome(Experiment("purcell-x", "X", "nowhere.x"), result)]
    assert f"| Purcell 2002 | 1 | {counts} |" in page_of(outcomes, about, "index")


def test_a_command_repeats_one_experiment(about: About) -> None:
    command = "raystream lab purcell foley --only a --only b --size 64 -o 'my folder'"
    several = about._replace(command=command)
    assert several.command_for("foley-times") == (
        "raystream lab foley --only times --size 64 -o 'my folder'"
    )


def test_markdown_tables_keep_their_columns(about: About, outcomes: list[Outcome]) -> None:
    text = page_of(outcomes, about, "purcell", ["p-1"])
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
    assert [one.name for one in files] == ["index.md", "purcell.md", "report.json", "about.json"]
    content = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    table = content["experiments"]["purcell-what"]["tables"][0]
    assert table["rows"] == [{"what": EVIL, "number": 1.5}, {"what": "none", "number": None}]
    assert json.loads((folder / "about.json").read_text(encoding="utf-8")) == content["about"]
    for name in ("p-1", "p-2", "p-3"):
        with Image.open(folder / "plots" / f"{name}.png") as image:
            assert image.width > 300
            assert len(np.unique(np.asarray(image.convert("RGB")).reshape(-1, 3), axis=0)) > 3


class Checker(HTMLParser):
    """Collects what a page loads, and bold text with handlers."""

    def __init__(self) -> None:
        super().__init__()
        self.loaded: list[str] = []
        self.handlers: list[str] = []
        self.cells: list[str] = []

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        given = dict(attributes)
        names = {"img": "src", "script": "src", "link": "href"}
        if tag in names and given.get(names[tag]):
            self.loaded.append(given[names[tag]] or "")
        self.handlers += [name for name in given if name.startswith("on")]

    def handle_data(self, data: str) -> None:
        self.cells.append(data)


def test_pages_are_built_safe_and_load_nothing_from_elsewhere(
    about: About, outcomes: list[Outcome], tmp_path: Path
) -> None:
    folder = tmp_path / "report"
    (folder / "pictures").mkdir(parents=True)
    (tmp_path / "scene.png").rename(folder / "pictures" / "scene.png")
    write_report(folder, outcomes, about)
    page = build_html(folder)
    assert page == folder / "html" / "index.html"
    checker = Checker()
    checker.feed((folder / "html" / "purcell.html").read_text(encoding="utf-8"))
    assert any("p-1" in one for one in checker.loaded)
    assert not [one for one in checker.loaded if "//" in one]
    assert not checker.handlers
    assert any(
        '</script><b onclick="x()">' in one.replace("“", '"').replace("”", '"')
        for one in checker.cells
    )


def test_what_sphinx_cannot_build_is_said(tmp_path: Path) -> None:
    with pytest.raises(RaystreamError, match="sphinx failed"):
        build_html(tmp_path)
