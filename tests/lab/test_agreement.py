"""Counts of a device against the CPU's."""

from __future__ import annotations

import pytest

from extras import need

need("raystream_lab")

from raystream_lab.agreement import agreement, agreement_claim, agreement_table


@pytest.mark.parametrize(
    ("device", "cpu", "ours", "begin"),
    [
        ("graphics", 200, 200, "equal"),
        ("graphics", 200, 201, "within 1%: rays are set up in pairs of float32"),
        ("graphics", 200, 203, "0.015 apart: rays are set up"),
        ("graphics", 0, 1, "inf apart"),
        ("cuda", 200, 201, "0.005 apart: not expected: CUDA has the CPU's bits"),
    ],
)
def test_a_difference_has_a_reason(device: str, cpu: int, ours: int, begin: str) -> None:
    assert agreement(device, cpu, ours).startswith(begin)


def test_counts_far_apart_fail_the_claim() -> None:
    rows = [("steps", 100, 100), ("tests", 1000, 1009), ("passes", 50, 52), ("none", 0, 1)]
    claim = agreement_claim("graphics", rows)
    assert claim.verdict == "holds in 2 of 4"
    assert claim.evidence == "1 of 4 counts are equal; not passes; not none"
    table = agreement_table("x", "X", "graphics", rows)
    assert [row["agreement"].split()[0] for row in table.records()] == [
        "equal",
        "within",
        "0.04",
        "inf",
    ]
