"""Counts of a device beside the CPU's, which the same rays have."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType

from raystream_lab.results import Cell, Claim, Table

#: Maximum relative difference of counts that are called near.
NEAR = 0.01

#: Why counts can differ at all, by device.
_CAUSES: Mapping[str, str] = MappingProxyType(
    {
        "graphics": "rays are set up in pairs of float32, not in float64: at the border of a cell, "
        "a different one can come first",
        "cuda": "not expected: CUDA has the CPU's bits, so this is an error",
    }
)

#: What is counted, the CPU's number, and the device's.
Row = tuple[str, float, float]


def agreement(device: str, cpu: float, ours: float) -> str:
    """How a device's count agrees with the CPU's: equal, within 1 %, or why not.

    Parameters
    ----------
    device : str
    cpu, ours : float
    """
    if ours == cpu:
        return "equal"
    share = abs(ours - cpu) / abs(cpu) if cpu else float("inf")
    if share <= NEAR and device == "graphics":
        return f"within {NEAR:.0%}: {_CAUSES[device]}"
    return f"{share:.2g} apart: {_CAUSES[device]}"


def agreement_table(name: str, title: str, device: str, rows: Iterable[Row], *notes: str) -> Table:
    """A table of counts: the CPU's, the device's, and how they agree.

    Parameters
    ----------
    name, title : str
    device : str
    rows : iterable of tuples
        What is counted, the CPU's number, and the device's.
    *notes : str
    """
    cells: list[list[Cell]] = [
        [what, cpu, ours, agreement(device, cpu, ours)] for what, cpu, ours in rows
    ]
    return Table.of(name, title, ["count", "CPU", device, "agreement"], cells, *notes)


def agreement_claim(device: str, rows: Iterable[Row]) -> Claim:
    """Judge whether the device counts what the CPU does, within 1 %.

    Parameters
    ----------
    device : str
    rows : iterable of tuples
        As for `agreement_table`.
    """
    listed = list(rows)
    equal = sum(ours == cpu for _, cpu, ours in listed)
    apart = [
        what for what, cpu, ours in listed if ours != cpu and not abs(ours - cpu) <= NEAR * cpu
    ]
    return Claim.judged(
        f"{device} counts the same steps, tests and runs as the CPU, within {NEAR:.0%}",
        "raystream's own guarantee",
        {what: what not in apart for what, _, _ in listed},
        f"{equal} of {len(listed)} counts are equal" + "".join(f"; not {one}" for one in apart),
    )
