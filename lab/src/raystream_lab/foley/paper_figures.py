"""Foley's own figures, checked against each other: no ray is traced."""

from __future__ import annotations

from typing import NamedTuple

from raystream_lab.foley.scenes import SIZE
from raystream_lab.foley.sensitivity import is_near
from raystream_lab.published import published
from raystream_lab.results import Cell, Claim, Result, Table, listed
from raystream_lab.runner import Runner

#: Kernels of Table 3 by the columns of Table 2. Leaf and Continue are not in Table 3.
_KERNELS = {"down": "kd down", "up": "kd up", "intersect": "kd intersect"}

_FLOAT_BYTES = 4


class BrutePrices(NamedTuple):
    """Nanoseconds per triangle test of brute force, from three places of the paper.

    Attributes
    ----------
    in_text : float
        From the rate in section 3.
    by_bandwidth : float
        From the bandwidth in Table 3.
    by_scene : dict of str to float
        From the times in Table 1.
    """

    in_text: float
    by_bandwidth: float
    by_scene: dict[str, float]

    def shortfall(self, scene: str) -> float:
        """The time at the rate of section 3, over that printed in Table 1."""
        return self.in_text / self.by_scene[scene]


def kernel_rates() -> dict[str, float]:
    """Runs per second of each kernel of Table 3: its bandwidth over the bytes of a run."""
    return {
        kernel: 1e9
        * row["gigabytes_per_second"]
        / (_FLOAT_BYTES * (row["floats_in"] + row["floats_out"]))
        for kernel, row in published("foley", "table 3").values.items()
    }


def brute_prices() -> BrutePrices:
    """The price of a test by section 3, Table 3 and Table 1."""
    scenes = published("foley", "scenes").values
    return BrutePrices(
        1e9 / published("foley", "claims").values["brute_tests_per_second"],
        1e9 / kernel_rates()["brute intersect"],
        {
            name: 1e6 * row["brute"] / (SIZE**2 * scenes[name]["triangles"])
            for name, row in published("foley", "table 1").values.items()
        },
    )


def full_rate_times() -> dict[str, dict[str, float]]:
    """Milliseconds of Table 2's kernel runs at the full rates of Table 3.

    Returns
    -------
    dict of str to dict of str to float
        By scene and traversal, then ``down``, ``up`` and ``intersect``.
    """
    rates = kernel_rates()
    return {
        case: {state: 1e9 * row[state] / rates[kernel] for state, kernel in _KERNELS.items()}
        for case, row in published("foley", "table 2").values.items()
    }


def paper_figures(runner: Runner) -> Result:  # noqa: ARG001 - as every experiment
    """Brute force in Table 1 against its rate, and the slowdown that Tables 1 to 3 imply."""
    prices = brute_prices()
    slowdowns = _slowdowns()
    return Result(
        tables=[_brute_table(prices), _slowdown_table(slowdowns), _rate_table()],
        claims=[
            _brute_claim(prices),
            _slowdown_claim(slowdowns),
            *_rate_claims(),
            _voxel_claim(),
        ],
    )


def rates() -> dict[str, dict[str, float]]:
    """Rays per second of Table 1, by scene and structure."""
    return {
        name: {structure: 1e3 * SIZE**2 / time for structure, time in row.items()}
        for name, row in published("foley", "table 1").values.items()
    }


def _rate_table() -> Table:
    named = published("foley", "rates")
    found = rates()
    structures = list(next(iter(found.values())))
    return Table.of(
        "foley-rates",
        f"Thousand rays per second by Table 1, and in the text: {named.source}",
        ["scene", *structures, "in the text"],
        [
            [name, *(each[one] / 1e3 for one in structures), _in_text(name)]
            for name, each in found.items()
        ],
        f"{SIZE} x {SIZE} rays over the printed times.",
    )


def _voxel_claim() -> Claim:
    """The grids of the large scenes are the finest cubic ones that fit."""
    most = published("foley", "grids")
    cells = {
        name: row["resolution"]
        for name, row in published("foley", "scenes").values.items()
        if name != "cornell"
    }
    return Claim.judged(
        f"Grids have at most {most.values['voxels']:,} voxels: those of the large scenes are the "
        "finest cubic ones",
        most.source,
        {name: n**3 <= most.values["voxels"] < (n + 1) ** 3 for name, n in cells.items()},
        "; ".join(f"{name} {n}³ = {n**3:,}" for name, n in cells.items()),
    )


def _in_text(name: str) -> str | None:
    named = published("foley", "rates").values
    low, high = (f"{rate / 1e3:g}" for rate in named["kdtree_complex"])
    if name == "bunny":
        return f"grid over {named['grid_bunny'] / 1e3:g}"
    return f"kd-trees roughly {low} to {high}" if name in ("robots", "kitchen") else None


def _rate_claims() -> list[Claim]:
    named, found = published("foley", "rates"), rates()
    low, high = named.values["kdtree_complex"]
    trees = {
        f"{name} {structure}": found[name][structure]
        for name in ("robots", "kitchen")
        for structure in ("restart", "backtrack")
    }
    grid = found["bunny"]["grid"]
    return [
        Claim.judged(
            f"The grid traces over {named.values['grid_bunny'] / 1e3:g} thousand rays per second "
            "in the bunny: it follows from the paper's own Table 1",
            named.source,
            {"bunny": grid > named.values["grid_bunny"]},
            f"{grid / 1e3:.0f} thousand",
        ),
        Claim.judged(
            f"The kd-trees trace roughly {low / 1e3:g} to {high / 1e3:g} thousand rays per second "
            "in the robots and the kitchen: it follows from the paper's own Table 1",
            named.source,
            {case: low <= rate <= high for case, rate in trees.items()},
            "thousands: " + listed({case: rate / 1e3 for case, rate in trees.items()}),
        ),
    ]


def _slowdowns() -> dict[str, tuple[float, float]]:
    """Milliseconds at full rates and in Table 1, by scene and traversal."""
    table = published("foley", "table 1").values
    found = {}
    for case, parts in full_rate_times().items():
        scene, traversal = case.split()
        found[case] = sum(parts.values()), table[scene][traversal]
    return found


def _brute_table(prices: BrutePrices) -> Table:
    scenes, table = (published("foley", place).values for place in ("scenes", "table 1"))
    rows: list[list[Cell]] = [
        ["section 3", None, None, prices.in_text, 1e3 / prices.in_text, None],
        ["Table 3", None, None, prices.by_bandwidth, 1e3 / prices.by_bandwidth, None],
    ]
    rows += [
        [f"Table 1, {name}", scenes[name]["triangles"], table[name]["brute"]]
        + [price, 1e3 / price, prices.shortfall(name)]
        for name, price in prices.by_scene.items()
    ]
    return Table.of(
        "foley-brute-price",
        "The cost of a triangle test by brute force, from three places in the paper",
        ["place", "triangles", "printed ms", "ns per test", "million tests per second"]
        + ["time at section 3's rate / printed"],
        rows,
        f"Table 1: {SIZE} x {SIZE} rays, each tested against all triangles. Table 3: bandwidth "
        "over the floats read and written by a test. The paper does not explain the difference: "
        "the times may be too small, or those of fewer rays.",
    )


def _brute_claim(prices: BrutePrices) -> Claim:
    near = {name: is_near(price, prices.in_text) for name, price in prices.by_scene.items()}
    short = {name: prices.shortfall(name) for name, held in near.items() if not held}
    return Claim.judged(
        "Brute force runs nearly "
        f"{published('foley', 'claims').values['brute_tests_per_second'] / 1e6:.0f} million tests "
        "per second: the paper's own times agree, within a quarter",
        "Foley 2005, section 3 and Table 1",
        near,
        f"nanoseconds per test: section 3 {prices.in_text:.3g}, Table 3 {prices.by_bandwidth:.3g}, "
        f"Table 1 {listed(prices.by_scene)}; the printed times are too small, or those of fewer "
        f"rays, by a factor of {listed(short)}",
    )


def _slowdown_table(slowdowns: dict[str, tuple[float, float]]) -> Table:
    rates = kernel_rates()
    parts = full_rate_times()
    return Table.of(
        "foley-full-rates",
        "Table 2's kernel runs at the full rates of Table 3, against the times of Table 1",
        ["scene and traversal", *(f"{state}, ms" for state in _KERNELS)]
        + ["at full rates, ms", "printed ms", "factor"],
        [
            [case, *parts[case].values(), full, printed, printed / full]
            for case, (full, printed) in slowdowns.items()
        ],
        "Million runs per second: "
        + ", ".join(f"{name} {rates[name] / 1e6:.0f}" for name in _KERNELS.values())
        + ", measured on the kitchen's rays without culling.",
        "Initialize, Leaf and Continue are not in Table 3 and are left out, so the factors are "
        "upper bounds.",
    )


def _slowdown_claim(slowdowns: dict[str, tuple[float, float]]) -> Claim:
    least = published("foley", "claims").values["slowdown_of_idle_lanes"]
    factors = {case: printed / full for case, (full, printed) in slowdowns.items()}
    return Claim.judged(
        f"Low utilisation costs more than a factor of {least}: it follows from the paper's own "
        "tables",
        "Foley 2005, section 5, Tables 1 to 3",
        {case: factor > least for case, factor in factors.items()},
        "times of Table 1 over those of Table 2's runs at Table 3's full rates (upper bounds): "
        + listed(factors, ".1f"),
    )
