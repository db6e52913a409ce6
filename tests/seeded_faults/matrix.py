"""The matrix: which file of tests catches which fault, kept in matrix.json."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from seeded_faults.attempts import ERROR, NOT_RUN, NOTHING, Row
from seeded_faults.by_file import CI, EVERYDAY
from seeded_faults.faults import Fault

MATRIX = Path(__file__).with_name("matrix.json")


def read_matrix(path: Path = MATRIX) -> dict[str, Row]:
    """The rows by the name of their fault; none if there is no file."""
    if not path.exists():
        return {}
    entries = json.loads(path.read_text(encoding="utf-8"))
    return {name: Row(**entry) for name, entry in entries.items()}


def write_matrix(path: Path, rows: Mapping[str, Row]) -> None:
    """Replace the file, with rows sorted by name and without what is as by default."""
    entries = {name: _entry(row) for name, row in sorted(rows.items())}
    new = path.with_suffix(".new")
    new.write_text(json.dumps(entries, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    new.replace(path)


def _entry(row: Row) -> dict[str, Any]:
    return {key: value for key, value in asdict(row).items() if value not in ("", (), [], {}, True)}


def refreshed(row: Row, fault: Fault, tiers: Mapping[str, str]) -> Row | None:
    """A row after tests have moved to another tier or are gone; None if nothing is left of it.

    Parameters
    ----------
    row : Row
    fault : Fault
    tiers : dict of str to str
        Of each test.
    """
    if row.verdict not in (EVERYDAY, CI) or fault.missing:
        return row
    left = {
        file: test
        for file, test in row.by.items()
        if test in tiers and (CI if fault.environment else tiers[test]) == row.verdict
    }
    if len(left) == len(row.by):
        return row
    return replace(row, by=left, is_complete=False) if left and row.verdict == EVERYDAY else None


def is_current(row: Row | None, fault: Fault, root: Path, *, stops_early: bool) -> bool:
    """Whether a fault need not be tried again.

    Parameters
    ----------
    row : Row or None
        What is known of it.
    fault : Fault
    root : Path
    stops_early : bool
        Whether one file that catches it suffices.
    """
    if row is None or row.digest != fault.digest(root) or row.verdict == ERROR:
        return False
    if row.verdict == NOT_RUN:
        return bool(fault.missing)
    if fault.missing:  # it was tried where what it needs is installed
        return True
    return row.is_complete or (stops_early and row.verdict != NOTHING)


def is_counted(fault: Fault) -> bool:
    """Whether the everyday tests should catch it: it needs no extra and is not in the lab."""
    return not fault.needs and fault.room != "lab"


def cover(rows: Mapping[str, Row], faults: Iterable[Fault]) -> list[tuple[str, list[str]]]:
    """A small set of files whose everyday tests catch all that everyday tests catch.

    Greedy: the file that catches most of what is left, again and again.

    Returns
    -------
    list of (str, list of str)
        Files, and the faults that each catches and those before it do not.
    """
    catches: dict[str, set[str]] = {}
    for fault in faults:
        row = rows.get(fault.name)
        if is_counted(fault) and row is not None and row.verdict == EVERYDAY:
            for file in row.by:
                catches.setdefault(file, set()).add(fault.name)
    chosen = []
    while any(catches.values()):
        best = min(catches, key=lambda file: (-len(catches[file]), file))
        found = catches.pop(best)
        chosen.append((best, sorted(found)))
        for names in catches.values():
            names -= found
    return chosen


def summary(rows: Mapping[str, Row], faults: Sequence[Fault], root: Path) -> list[str]:
    """Lines for people: how many faults are caught by what, and which rows are stale."""
    verdicts = Counter(rows[fault.name].verdict for fault in faults if fault.name in rows)
    counted = [fault for fault in faults if is_counted(fault)]
    everyday = [f for f in counted if f.name in rows and rows[f.name].verdict == EVERYDAY]
    caught = f"{verdicts[EVERYDAY]} caught by everyday tests, {verdicts[CI]} only by those of ci"
    others = (
        f"{verdicts[NOTHING]} by nothing; {verdicts[NOT_RUN]} not run, {verdicts[ERROR]} errors"
    )
    lines = [
        f"{len(faults)} faults: {caught}, {others}, {len(faults) - verdicts.total()} not tried",
        f"{len(counted)} need no extra and are not in the lab: {len(everyday)} caught by everyday",
    ]
    stale = [
        fault.name
        for fault in faults
        if fault.name in rows and rows[fault.name].digest != fault.digest(root)
    ]
    return lines + [f"stale: {name}" for name in stale]
