"""Foley's claims on Table 1, judged by our times and counts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from raystream.jit.threads import thread_count
from raystream_lab.foley.other_views import kernel_runs, lead
from raystream_lab.foley.sensitivity import is_near
from raystream_lab.published import published
from raystream_lab.results import Claim, listed

#: Brute force counts as linear if the time per test agrees in all scenes within this share.
_LINEAR = 0.25

#: Scenes with details of many sizes, in which restart and backtrack are very similar.
_COMPLEX = ("robots", "kitchen")

#: The structures of fast CPU ray tracers.
_CPU_STRUCTURES = ("stack", "bvh")

Found = Mapping[str, Mapping[str, Any]]

#: Cost per ray, by scene and structure.
Costs = Mapping[str, Mapping[str, float]]


def time_claims(
    both: Mapping[str, Found], counts: Found, triangles: Mapping[str, int]
) -> list[Claim]:
    """Judge section 4.1 by the times of both machines and by counts.

    Parameters
    ----------
    both : mapping
        ``"branching"`` and ``"multipass"``: by scene and structure, ``best`` seconds for ``rays``.
    counts : mapping
        By scene and structure, ``steps``, ``leaves`` and ``tests`` per ray. Counts are steps and
        tests; kernel runs include Foley's Leaf and Continue.
    triangles : mapping of str to int
        Triangles of each scene.
    """
    ways: dict[str, Costs] = {
        way: {
            name: {s: one["best"] / one["rays"] for s, one in each.items()}
            for name, each in found.items()
        }
        for way, found in both.items()
    }
    ways["counts"] = {
        name: {s: one["steps"] + one["tests"] for s, one in each.items()}
        for name, each in counts.items()
    }
    ways["kernel runs"] = {
        name: {s: kernel_runs(s, one) for s, one in each.items()} for name, each in counts.items()
    }
    present = set(triangles)
    claims = [_ahead(ways), _most(ways)] if present & set(_COMPLEX) else []
    claims += [_uneven(ways)] if {"robots", "bunny"} <= present else []
    claims += [_even(ways)] if "bunny" in present else []
    claims += [_linear(ways["branching"], triangles), _close(ways), _fast(ways["branching"])]
    return claims


def _ahead(ways: Mapping[str, Costs]) -> Claim:
    leads = {
        f"{way} {name}": lead(each[name])
        for way, each in ways.items()
        for name in _COMPLEX
        if name in each
    }
    return Claim.judged(
        "In the robots and the kitchen, the kd-trees are faster than a grid",
        "Foley 2005, Table 1, section 4.1",
        {case: ratio > 1.0 for case, ratio in leads.items()},
        f"grid / better of the two: {listed(leads)}",
    )


def _most(ways: Mapping[str, Costs]) -> Claim:
    """The abstract's "up to" is the largest lead among the scenes, not a lower bound."""
    theirs = published("foley", "table 1").values
    old = max(lead(theirs[name]) for name in _COMPLEX)
    leads = {
        way: max(lead(each[name]) for name in _COMPLEX if name in each)
        for way, each in ways.items()
    }
    near = {way: is_near(ratio, old) for way, ratio in leads.items()}
    others = [way for way, held in near.items() if not held]
    return Claim.judged(
        "In scenes with objects of many sizes, kd-trees are up to "
        f"{published('foley', 'claims').values['kdtree_over_grid_most']} times faster than a grid "
        "(read as: the largest ratio of times is Table 1's, within a quarter)",
        "Foley 2005, abstract and Table 1",
        near,
        f"largest grid / better kd-tree: published {old:.3g}; ours {listed(leads)}"
        + (f"; not within a quarter: {', '.join(others)}" if others else ""),
    )


def _uneven(ways: Mapping[str, Costs]) -> Claim:
    least = published("foley", "claims").values["grid_robots_over_bunny"]
    ratios = {way: each["robots"]["grid"] / each["bunny"]["grid"] for way, each in ways.items()}
    return Claim.judged(
        f"A grid is more than {least} times slower in the robots than in the bunny",
        "Foley 2005, section 4.1",
        {way: ratio > least for way, ratio in ratios.items()},
        listed(ratios),
    )


def _even(ways: Mapping[str, Costs]) -> Claim:
    ratios = {way: lead(each["bunny"]) for way, each in ways.items()}
    return Claim.judged(
        "In the bunny, a grid is faster than the stackless kd-trees",
        "Foley 2005, Table 1",
        {way: ratio < 1.0 for way, ratio in ratios.items()},
        f"grid / better of the two: {listed(ratios)}",
    )


def _linear(branching: Costs, triangles: Mapping[str, int]) -> Claim:
    """Large scenes only: in a small one, ray set-up also takes time."""
    prices = {
        name: 1e9 * each["brute"] / triangles[name]
        for name, each in branching.items()
        if name != "cornell"
    }
    theirs = published("foley", "table 1").values
    cases = {}
    if len(prices) > 1:
        mean = sum(prices.values()) / len(prices)
        cases = {name: abs(price / mean - 1.0) <= _LINEAR for name, price in prices.items()}
    rays = 512**2
    published_counts = published("foley", "scenes").values
    old = {
        name: 1e6 * theirs[name]["brute"] / rays / published_counts[name]["triangles"]
        for name in prices
    }
    return Claim.judged(
        "Brute force is linear in the number of triangles",
        "Foley 2005, section 4.1",
        cases,
        f"nanoseconds per ray and triangle: {listed(prices)}; published {listed(old)}",
    )


def _close(ways: Mapping[str, Costs]) -> Claim:
    """Restart and backtrack are no further apart than the published times of these scenes."""
    theirs = published("foley", "table 1").values
    most = max(_apart(theirs[name]) for name in _COMPLEX)
    apart = {
        f"{way} {name}": _apart(each[name])
        for way, each in ways.items()
        for name in _COMPLEX
        if name in each
    }
    return Claim.judged(
        "In the robots and the kitchen, restart and backtrack are close: no further apart than "
        "in Table 1",
        "Foley 2005, section 4.1",
        {case: ratio <= most for case, ratio in apart.items()},
        f"published at most {most:.3g} times; ours {listed(apart)}",
    )


def _apart(each: Mapping[str, float]) -> float:
    ratio = each["restart"] / each["backtrack"]
    return max(ratio, 1.0 / ratio)


def _fast(branching: Costs) -> Claim:
    """The rates of CPUs, of which the paper says "up to a few million rays per second"."""
    rates = {
        f"{name} {structure}": 1e-6 / each[structure]
        for name, each in branching.items()
        for structure in _CPU_STRUCTURES
        if structure in each
    }
    return Claim.judged(
        f"CPUs trace {published('foley', 'rates').values['cpu']} rays per second (read as: at "
        "least a million, on this one)",
        "Foley 2005, section 5",
        {case: rate >= 1.0 for case, rate in rates.items()},
        f"million rays/s with {thread_count()} threads: {listed(rates)}",
    )
