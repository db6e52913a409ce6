"""Results, published values, and stored measurements."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from extras import need

need("raystream_lab")

from raystream.core.errors import FileFormatError
from raystream_lab import Claim, Store, Table, comparison, published
from raystream_lab.published import _file
from raystream_lab.report.cell_text import cell_text


def test_rows_have_as_many_cells_as_columns() -> None:
    with pytest.raises(ValueError, match="speed: 2 columns"):
        Table.of("speed", "Speed", ["scene", "rays"], [["bunny", 1], ["kitchen"]])


def test_comparison_adds_ratios_of_numbers() -> None:
    table = comparison(
        "x",
        "X",
        [("a", 4.0, 6.0, ""), ("b", None, 6.0, ""), ("c", "1 to 2", 3, ""), ("d", 0, 3, "")],
    )
    assert [row[3] for row in table.rows] == [1.5, None, None, None]
    assert table.records()[0] == {
        "quantity": "a",
        "published": 4.0,
        "ours": 6.0,
        "ratio": 1.5,
        "why they differ": "not explained",
    }


def test_no_difference_is_without_a_reason() -> None:
    rows = [
        ("equal", 4.0, 4.0),
        ("a quarter more", 4.0, 5.0),
        ("more", 4.0, 5.01),
        ("a quarter less", 4.0, 3.0),
        ("less", 4.0, 2.99),
        ("from nothing", 0, 1),
        ("to nothing", 1, 0),
        ("nothing at all", 0, 0),
        ("text", "1 to 2", 9),
        ("missing", None, 9),
    ]
    found = comparison("x", "X", [(*row, "") for row in rows]).records()
    unexplained = {row["quantity"] for row in found if row["why they differ"]}
    assert unexplained == {"more", "less", "from nothing", "to nothing"}
    assert {row["why they differ"] for row in found} == {"", "not explained"}
    given = comparison("x", "X", [("more", 4.0, 9.0, "camera b gives 4")]).records()
    assert given[0]["why they differ"] == "camera b gives 4"


def test_tables_with_other_columns_need_reasons_too() -> None:
    columns = ["scene", "published", "ours, branching", "ratio", "why they differ"]
    table = Table.of("x", "X", columns, [["a", 1.0, 2.0, 2.0, ""], ["b", 1.0, 1.1, 1.1, ""]])
    assert [row[-1] for row in table.rows] == ["not explained", ""]


@pytest.mark.parametrize(
    ("cases", "verdict"),
    [
        ({"a": True, "b": True}, "holds"),
        ({"a": True, "b": False}, "holds in 1 of 2"),
        ({"a": True, "b": False, "c": True}, "holds in 2 of 3"),
        ({"a": False, "b": False}, "does not hold (0 of 2)"),
        ({}, "not measured"),
    ],
)
def test_verdicts_follow_from_cases(cases: dict[str, bool], verdict: str) -> None:
    assert Claim.judged("claim", "source", cases, "evidence").verdict == verdict


@pytest.mark.parametrize(
    ("cell", "text"),
    [
        (None, "–"),
        ("", ""),
        (True, "yes"),
        (1234567, "1,234,567"),
        (0.0, "0"),
        (1.0, "1"),
        (0.5, "0.5"),
        (12.345, "12.3"),
        (123.456, "123.5"),
        (100.0, "100"),
        (1234.5, "1,234"),
        (0.00123, "0.00123"),
        (1e-6, "1.00e-06"),
        (float("nan"), "–"),
    ],
)
def test_cells_are_short(cell: Any, text: str) -> None:
    assert cell_text(cell) == text


# Published values.


def leaves(values: Any) -> Iterator[Any]:
    if isinstance(values, dict):
        for inner in values.values():
            yield from leaves(inner)
    elif isinstance(values, list):
        for inner in values:
            yield from leaves(inner)
    else:
        yield values


def test_every_published_value_has_a_place() -> None:
    for paper, places in _file().items():
        for place, entry in places.items():
            if place in ("name", "title", "authors", "venue", "doi"):
                continue
            found = published(paper, place)
            assert found.place
            assert found.source.startswith(places["name"])
            assert all(isinstance(one, int | float | str) for one in leaves(entry["values"])), place


def test_printed_totals_are_sums() -> None:
    # Purcell 2002, Table 2: the totals of the paper add up.
    for row in published("purcell", "table 2").values.values():
        assert row["total"] == row["traversal"] + row["intersection"] + row["other"]
        assert row["most_steps"] <= row["traversal"]
        assert row["most_tests"] <= row["intersection"]


# Measurements on disk.


def store(path: Path, **settings: Any) -> Store:
    return Store(path / "measurements.json", settings or {"quick": True}, "here")


def test_store_keeps_measurements(tmp_path: Path) -> None:
    first = store(tmp_path)
    first.save("a", {"x": [1, 2.5, None]})
    first.save("b", 3)
    second = store(tmp_path)
    assert second.values == {}
    second.read()
    assert second.values == {"a": {"x": [1, 2.5, None]}, "b": 3}
    assert second.foreign_count == 0
    third = Store(second.path, {"quick": True}, "another source")
    third.read()
    third.save("b", 4)
    third.read()
    assert (third.foreign_count, third.values["b"]) == (1, 4)


def test_store_without_a_file_is_empty(tmp_path: Path) -> None:
    fresh = store(tmp_path)
    fresh.read()
    assert fresh.values == {}


def test_store_refuses_other_settings(tmp_path: Path) -> None:
    store(tmp_path, quick=True, size=None).save("a", 1)
    with pytest.raises(FileFormatError, match=r"quick True.*not with quick False"):
        store(tmp_path, quick=False, size=None).read()


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        '{"layout": 1}',
        '{"layout": 2, "settings": {}, "measurements": {}}',
        '{"layout": 1, "settings": {}, "measurements": []}',
        '{"layout": 1, "settings": {}, "measurements": {"a": 1}}',
        '{"layout": 1, "settings": {}, "measurements": {"a": {"value": 1}}}',
        '{"layout": 1, "settings": {}, "measurements": {"a": {"source": 1, "seconds": 1}}}',
        '{"layout": 1, "settings": {}, "measurements": {"a": {"source": 1, "value": 1}}}',
        '{"layout": 1, "settings": {}, "measurements": {"a": {"source": "", "value": 1}}}',
        "[" * 100_000,
        "\x00\xff",
    ],
)
def test_store_refuses_damaged_files(tmp_path: Path, text: str) -> None:
    (tmp_path / "measurements.json").write_text(text, encoding="utf-8")
    with pytest.raises(FileFormatError, match="contains no measurements"):
        store(tmp_path).read()


def test_store_refuses_what_json_cannot_hold(tmp_path: Path) -> None:
    kept = store(tmp_path)
    kept.save("a", 1)
    with pytest.raises(ValueError, match="JSON"):
        kept.save("b", float("inf"))
    assert list(json.loads(kept.path.read_text())["measurements"]) == ["a"]


def test_column_names_are_unique() -> None:
    with pytest.raises(ValueError, match="speed: columns must be unique"):
        Table.of("speed", "Speed", ["scene", "rays", "rays"], [])
