"""The claim about the threshold, judged alike for Purcell and Christen."""

from __future__ import annotations

import pytest

from extras import need

need("raystream_lab")

from raystream_lab.christen.kernel_calls import _threshold
from raystream_lab.purcell.schedules import _claims
from raystream_lab.threshold_rule import near_fewest, threshold_claim


@pytest.mark.parametrize(
    ("at_the_rule", "verdict"),
    [
        ((100, 110), "holds"),
        ((110, 111), "holds in 1 of 2"),
        ((200, 111), "does not hold (0 of 2)"),
    ],
)
def test_within_a_tenth_is_fewest(at_the_rule: tuple[int, int], verdict: str) -> None:
    sweeps = {
        f"view {number}": {0.1: 150, 0.2: count, 0.4: 100}
        for number, count in enumerate(at_the_rule)
    }
    assert threshold_claim("a paper", 0.2, sweeps).verdict == verdict


def test_evidence_names_the_best_threshold() -> None:
    claim = threshold_claim("a paper", 0.2, {"A": {0.1: 150, 0.2: 120, 0.4: 100}})
    assert claim.evidence == "passes at 20 % over the fewest: A 1.20 (at 40 %)"


def test_near_thresholds() -> None:
    assert near_fewest({0.1: 150, 0.2: 110, 0.3: 100, 0.4: 111}) == [0.2, 0.3]


@pytest.mark.parametrize("count", [108, 112])
def test_both_papers_are_judged_alike(count: int) -> None:
    schedule = {
        "schedulers": {"naive": 900, "threshold": count},
        "optimal": 90,
        "passes": count,
        "efficiency": 0.1,
        "sweep": [[10, 150], [20, count], [40, 100]],
    }
    purcell = next(one for one in _claims({"A": schedule}) if "fewest" in one.text)
    christen = _threshold({"A": {"0.1": 150, "0.2": count, "0.4": 100}})
    assert (purcell.text, purcell.verdict, purcell.evidence) == (
        christen.text,
        christen.verdict,
        christen.evidence,
    )
    assert purcell.source != christen.source
