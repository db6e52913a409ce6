"""The savings of a mailbox (Purcell 2002, section 3.1.3, which has none)."""

from __future__ import annotations

from typing import Any

from raystream_lab.purcell.image_counts import SIZE
from raystream_lab.purcell.schedules import record_view
from raystream_lab.results import Cell, Result, Table
from raystream_lab.runner import Runner
from raystream_lab.views import PURCELL_VIEWS
from raystream_lab.walks import repeated_tests


def mailbox(runner: Runner) -> Result:
    """Repeated tests of a triangle by the same ray in several cells."""
    result = Result()
    rows: list[list[Cell]] = []
    entries: list[int] = []
    size = runner.size(SIZE)
    for name, found in result.available(PURCELL_VIEWS, lambda name: _repeats(runner, name, size)):
        tests = max(found["tests"], 1)
        entries = [count for count, _ in found["saved"]]
        shares = [saved / tests for _, saved in found["saved"]]
        rows.append([name, found["tests"] / size**2, found["repeats"] / tests, *shares])
    result.tables = [
        Table.of(
            "purcell-mailbox",
            f"Repeated tests of a ray, as shares of all tests, {size} x {size}",
            [
                "view",
                "tests per ray (t)",
                "any mailbox could save",
                *(f"{count} entries save" for count in entries),
            ],
            rows,
            "Without a mailbox, a triangle that lies in several cells is tested in each of them "
            "that the ray visits. Entries: those of each ray's mailbox, addressed by the "
            "triangle's number modulo their count.",
        )
    ]
    return result


def _repeats(runner: Runner, name: str, size: int) -> dict[str, Any]:
    """Tests, repeated tests, and savings of mailboxes."""

    def measure() -> dict[str, Any]:
        found = repeated_tests(record_view(runner, name, visits=True))
        saved = [[entries, count] for entries, count in found.saved.items()]
        return {"tests": found.tests, "repeats": found.repeats, "saved": saved}

    found: dict[str, Any] = runner.measure(f"{name}, {size} x {size}", measure)
    return found
