"""Text of table cells, and the table of claims."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import astuple

from raystream_lab.results import Cell, Claim, Table

NOTHING = "–"


def is_number(cell: Cell) -> bool:
    """Whether a cell is right-aligned."""
    return isinstance(cell, int | float) and not isinstance(cell, bool)


def are_numbers(table: Table) -> list[bool]:
    """Whether each column is right-aligned: those with a number are."""
    return [any(is_number(row[k]) for row in table.rows) for k in range(len(table.columns))]


def claims_table(claims: Iterable[Claim]) -> Table:
    """The table of claims and verdicts."""
    return Table.of(
        "claims",
        "The papers' claims and our verdicts",
        ("claim", "source", "verdict", "evidence"),
        [(one.text[:1].upper() + one.text[1:], *astuple(one)[1:]) for one in claims],
    )


def cell_text(cell: Cell) -> str:
    """Format a cell: three significant digits, whole integers, a dash for missing values."""
    if cell is None or cell == "":
        return NOTHING if cell is None else ""
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    if isinstance(cell, int):
        return f"{cell:,}"
    if isinstance(cell, float):
        return _float_text(cell)
    return cell


def _float_text(number: float) -> str:
    if number != number:
        return NOTHING
    size = abs(number)
    if size != 0.0 and (size >= 1e15 or size < 1e-4):
        return f"{number:.2e}"
    if size >= 1000.0:
        return f"{number:,.0f}"
    text = f"{number:.3g}" if size < 100.0 else f"{number:.1f}" if size < 1000.0 else ""
    return text.rstrip("0").rstrip(".") if "." in text and "e" not in text else text
