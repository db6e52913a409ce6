"""The claim of Purcell and Christen that a threshold of 20 % takes the fewest passes."""

from __future__ import annotations

from collections.abc import Mapping

from raystream_lab.results import Claim

#: Counts up to this multiple of the fewest count as fewest: our choice, for both papers.
_NEAR = 1.1


def near_fewest(sweep: Mapping[float, int]) -> list[float]:
    """Thresholds whose passes are within a tenth of the fewest.

    Parameters
    ----------
    sweep : mapping of float to int
        Passes by threshold.
    """
    fewest = min(sweep.values())
    return [threshold for threshold, count in sweep.items() if count <= _NEAR * fewest]


def threshold_claim(
    source: str, threshold: float, sweeps: Mapping[str, Mapping[float, int]]
) -> Claim:
    """Judge that a threshold takes the fewest passes, within a tenth.

    Parameters
    ----------
    source : str
        Paper and place.
    threshold : float
        The paper's share of rays that wait for an intersection.
    sweeps : mapping of str to mapping of float to int
        By scene, passes by threshold; among them the paper's.
    """
    evidence = []
    for name, sweep in sweeps.items():
        best = min(sweep, key=lambda one: sweep[one])
        evidence.append(f"{name} {sweep[threshold] / sweep[best]:.2f} (at {100 * best:.0f} %)")
    share = f"{100 * threshold:.0f} %"
    return Claim.judged(
        f"testing triangles once {share} of the rays wait for it takes the fewest passes (here: "
        "within a tenth of the fewest)",
        source,
        {name: threshold in near_fewest(sweep) for name, sweep in sweeps.items()},
        f"passes at {share} over the fewest: " + ", ".join(evidence),
    )
