"""Tables of kernels: our kernels and the corresponding rows of the papers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from extras import need

need("raystream_lab")

from raystream_lab import Runner, Store, published
from raystream_lab.purcell import compiled_kernels

FIGURES = {
    "code": 100,
    "loop": 40,
    "machine": 120,
    "in": 30,
    "out": 15,
    "fetched": 2,
}


def test_kernels_stand_beside_their_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def figures(runner: Runner, structure: str) -> list[dict[str, Any]]:
        names = ("set up", "traverse", "intersect", "shade")
        return [{"kernel": name, **FIGURES} for name in names]

    monkeypatch.setattr(compiled_kernels, "cost_figures", figures)
    monkeypatch.setattr(compiled_kernels, "published_figures", lambda runner: figures(runner, ""))
    runner = Runner(tmp_path, Store(tmp_path / "measurements.json", {}, ""), quick=True)
    (table,) = compiled_kernels.compiled_kernels(runner).tables
    rows = {row["kernel"]: row for row in table.records()}
    paper = published("purcell", "table 1").values
    assert rows["grid: traverse"]["Table 1"] == paper["multipass"]["step"]["instructions"]
    assert (
        rows["grid: traverse"]["Table 1, branching"] == paper["branching"]["step"]["instructions"]
    )
    assert rows["grid: traverse"]["a further step"] == 40
    assert rows["grid: intersect"]["M"] == paper["multipass"]["intersect"]["memory"]
    assert rows["grid: set up"]["W"] == paper["multipass"]["set up"]["written"]
    assert rows["grid: shade"]["Table 1"] is None
    printed = rows["grid, as published: intersect"]
    assert printed["Table 1"] == paper["multipass"]["intersect"]["instructions"]
