"""Triangle tests per second, published and on this machine (Purcell 2002, section 5.2)."""

from __future__ import annotations

from typing import Any

from raystream.core.errors import RaystreamError
from raystream.jit.threads import thread_count
from raystream.tracer import Tracer
from raystream_lab.cost_model import prices
from raystream_lab.published import published
from raystream_lab.purcell.image_counts import SIZE, count_image, grid_options
from raystream_lab.purcell.scene_statistics import image_statistics
from raystream_lab.results import Cell, Result, Table
from raystream_lab.runner import Runner
from raystream_lab.timing import median_times
from raystream_lab.views import View

_VIEW = "bunny on a floor"

#: Image size for brute force: each ray tests all triangles.
_BRUTE_SIZE = 128

_ROUNDS = 5


def triangle_rate(runner: Runner) -> Result:
    """Rates implied by Table 1, and rates of our engines on this machine."""
    result = Result(tables=[_implied()])
    try:
        rows = [_engine(runner, structure) for structure in ("brute", "grid", "kdtree", "bvh")]
    except RaystreamError as error:
        result.notes.append(f"our engines are omitted: {error}")
        return result
    claims = published("foley", "claims").values
    speed = published("purcell", "speed").values
    result.tables.append(
        Table.of(
            "purcell-engines",
            f"Our engines on this machine, {thread_count()} threads: {_VIEW}",
            [
                "structure",
                "rays",
                "million rays/s",
                "tests per ray",
                "million tests/s",
                "ns per ray",
            ],
            rows,
            "Tests per second: all tests of the image's rays over the time of the image, which "
            "includes traversal. Times are medians of rounds without counters; tests are counted "
            "in another run. The BVH traces many rays at once, but its counts are those of single "
            "rays.",
            f"Published: {speed['pentium_intersections_per_second'] / 1e6:g} million tests/s by a "
            "Pentium III of 800 MHz (Wald, cited in Purcell 2002, section 5.2), and nearly "
            f"{claims['brute_tests_per_second'] / 1e6:g} million by a Radeon X800 with brute force "
            "(Foley 2005, section 3).",
        )
    )
    return result


def _implied() -> Table:
    speed = published("purcell", "speed")
    intersect = prices("branching")["intersect"]
    values = speed.values
    rows: list[list[Cell]] = []
    for rate, printed in zip(
        values["instructions_per_second"], values["intersections_per_second"], strict=True
    ):
        found = rate / intersect.instructions
        bandwidth = found * intersect.memory * 4
        rows.append(
            [
                f"{rate / 1e9:g} G instructions/s",
                printed / 1e6,
                found / 1e6,
                found / printed,
                bandwidth / 1e9,
                bandwidth <= values["bytes_per_second"],
            ]
        )
    return Table.of(
        "purcell-5.2",
        f"Millions of triangle tests per second from Table 1: {speed.source}",
        ["machine", "published", "ours", "ratio", "GB/s needed", "within 8 GB/s"],
        rows,
        f"{intersect.instructions} instructions and {intersect.memory} words per test. On the "
        "faster machine the tests alone would need more than the 8 GB/s, unless the texture "
        "cache serves some of them: the paper's statement that not all of the bandwidth would be "
        "used relies on it.",
    )


def _engine(runner: Runner, structure: str) -> list[Cell]:
    """A row of the table."""
    size = min(runner.size(SIZE), _BRUTE_SIZE) if structure == "brute" else runner.size(SIZE)
    rounds = 1 if runner.quick else _ROUNDS

    def measure() -> dict[str, Any]:
        view = runner.view(_VIEW)
        options = grid_options(view, runner.quick) if structure == "grid" else {}
        seconds = _seconds(Tracer(view.scene, structure, **options), view, size, rounds)
        return {"seconds": seconds, "tests": _tests(runner, view, structure, size)}

    found = runner.measure(f"{structure}, {size} x {size}, {rounds} rounds", measure)
    rays, seconds = size * size, found["seconds"]
    return [
        structure,
        rays,
        rays / seconds / 1e6,
        found["tests"],
        rays * found["tests"] / seconds / 1e6,
        seconds / rays * 1e9,
    ]


def _seconds(tracer: Tracer, view: View, size: int, rounds: int) -> float:
    """Median seconds of an image's first hits."""
    rays = view.rays(size)
    return median_times({"": lambda: tracer.first_hit(*rays)}, rounds)[""]


def _tests(runner: Runner, view: View, structure: str, size: int) -> float:
    """Mean tests per ray, counted."""
    if structure == "brute":
        return float(view.scene.triangle_count)
    if structure == "grid":
        return image_statistics(runner, _VIEW)["t"]
    return count_image(Tracer(view.scene, structure, counters=True), view, size)["t"]
