"""The texture cache with the references of both machines (Purcell 2002, section 4.2, Figure 9)."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from raystream.jit.threads import thread_count
from raystream_lab.caches import Cache, LineCounts, ReuseDistances, feed_chunks
from raystream_lab.cost_model import prices
from raystream_lab.published import published
from raystream_lab.purcell.image_counts import SIZE, grid_tracer
from raystream_lab.purcell.schedules import record_view
from raystream_lab.results import Cell, Claim, Plot, Result, Series, Table, listed
from raystream_lab.runner import Runner
from raystream_lab.views import PURCELL_VIEWS
from raystream_lab.walks import (
    Kind,
    ReferenceChunk,
    StateWords,
    Walks,
    branching_references,
    multipass_references,
    record,
    replay,
)

#: In the order of `Kind`.
KIND_NAMES = ("grid", "lists", "triangles", "shading", "state")

#: Image size for the curve over all cache sizes.
_CURVE_SIZE = 512

#: Image size for other caches, and their sizes, lines and ways; for the most and least coherent
#: view.
_OTHERS_SIZE = 256
_SIZES = (8, 16, 32, 64, 128, 256)
_LINES = (16, 32, 48, 64, 128)
_WAYS: tuple[int | None, ...] = (1, 2, 4, None)

_VARIED = ("bunny on a floor", "forest inside")

#: Bytes, from the size of a register file to a card's memory.
_CURVE_BYTES = tuple(1 << k for k in range(10, 27))

#: The multipass machine with rays in another order, without reads of state.
_TILED = "multipass, tiles"
_NO_STATE = StateWords(0, 0, 0, 0)


def texture_cache(runner: Runner) -> Result:
    """Figure 9, other caches, and caches of every size."""
    result = Result()
    found: dict[str, dict[str, Any]] = {}
    curves: dict[str, dict[str, Any]] = {}
    varied: dict[str, dict[str, float]] = {}
    for name, one in result.available(PURCELL_VIEWS, lambda name: _image(runner, name)):
        found[name] = one
        curves[name] = _curve(runner, name)
        if name in _VARIED:
            varied[name] = _others(runner, name)
    size = runner.size(SIZE)
    result.tables = [_figure_9(found, size), _hit_rates(found, size), _varied_table(varied)]
    result.plots = [_curve_plot(curves)]
    result.claims = _claims(found)
    return result


def paper_cache(kinds: tuple[str, ...] = KIND_NAMES) -> Cache:
    """Purcell's cache: 64 KB, direct-mapped, lines of 48 bytes."""
    values = published("purcell", "cache").values
    return Cache(values["bytes"], values["line"], values["ways"], kinds=kinds)


def _image(runner: Runner, name: str) -> dict[str, Any]:
    """Counts of Purcell's cache, for all references and for data only.

    By machine, and for multipass also with rays in tiles of the image.
    """
    size = runner.size(SIZE)

    def measure() -> dict[str, Any]:
        walks = record_view(runner, name, visits=True)
        schedule = replay(walks)
        traces = {
            "branching": (branching_references(walks), False),
            "multipass": (multipass_references(walks, schedule), True),
            _TILED: (
                multipass_references(walks, schedule, state_words=_NO_STATE, order="tiles"),
                False,
            ),
        }
        with ThreadPoolExecutor(thread_count()) as pool:
            counts = pool.map(lambda one: _through(*one), traces.values())
        return {
            **dict(zip(traces, counts, strict=True)),
            "stencil": len(schedule) * len(walks),
            "runs": schedule.runs,
        }

    found: dict[str, Any] = runner.measure(f"{name}, cache, {size} x {size}", measure)
    return found


def _through(trace: Iterator[ReferenceChunk], has_state: bool) -> dict[str, Any]:
    """Counts by kind of data: all references in one cache, data only in another."""
    data, everything = paper_cache(), paper_cache()

    def without_state(chunk: ReferenceChunk) -> None:
        kept = chunk.kinds != Kind.STATE
        _access(data, ReferenceChunk(*(array[kept] for array in chunk)))

    if has_state:
        feed_chunks(trace, [functools.partial(_access, everything), without_state])
    else:
        feed_chunks(trace, [functools.partial(_access, data)])
    counts = {"data": _plain(data)}
    return {**counts, "all": _plain(everything)} if has_state else counts


def _access(simulator: Cache | ReuseDistances, chunk: ReferenceChunk) -> None:
    simulator.access(chunk.addresses, chunk.kinds, chunk.words * np.uint8(4))


def _plain(cache: Cache) -> dict[str, dict[str, float]]:
    return {name: _figures(one) for name, one in cache.counts.items() if one.references}


def _figures(one: LineCounts) -> dict[str, float]:
    return {
        "references": one.references,
        "hit_rate": one.hit_rate,
        "asked": one.bytes_requested,
        "fetched": one.bytes_fetched,
    }


def _figure_9(found: dict[str, dict[str, Any]], size: int) -> Table:
    rows: list[list[Cell]] = [
        [name, architecture, *_ratios(one, architecture)]
        for name, one in found.items()
        for architecture in ("multipass", "branching")
    ]
    return Table.of(
        "purcell-figure-9",
        f"Bytes read and written with the cache over those without (Figure 9); {size} x {size}",
        [
            "view",
            "architecture",
            *KIND_NAMES[:4],
            "all, state uncached",
            "state, cached",
            "all, state cached",
        ],
        rows,
        "The figure's bars are not in our copy of the paper. All: data, ray state between "
        "passes, and the stencil; writes bypass the cache.",
        "Above 1 the cache reads more than it serves: a miss fetches a line of 48 bytes for a "
        "word of 4 or a texel of 12 or 16.",
        "The paper says that a line of 48 bytes holds 3 RGB texels or 4 RGBA ones. In floats "
        "of 4 bytes it holds 4 RGB or 3 RGBA ones.",
    )


def _ratios(one: dict[str, Any], architecture: str) -> list[Cell]:
    """Traffic by kind, and in total."""
    counts = one[architecture]["data"]
    ratios: list[Cell] = [
        counts[kind]["fetched"] / counts[kind]["asked"] if kind in counts else None
        for kind in KIND_NAMES[:4]
    ]
    asked = sum(kind["asked"] for kind in counts.values())
    fetched = sum(kind["fetched"] for kind in counts.values())
    if architecture == "branching":
        return [*ratios, fetched / asked, None, None]
    beside = _uncached_bytes(one)
    both = one["multipass"]["all"]
    state = both["state"]
    all_fetched = sum(kind["fetched"] for kind in both.values())
    whole = asked + state["asked"] + beside
    return [
        *ratios,
        (fetched + state["asked"] + beside) / whole,
        state["fetched"] / state["asked"],
        (all_fetched + beside) / whole,
    ]


def _uncached_bytes(one: dict[str, Any]) -> float:
    """Bytes that bypass the cache: writes of passes, and stencils."""
    table, runs = prices("multipass"), one["runs"]
    rows = {"traverse": "step", "intersect": "intersect", "set up": "set up", "shade": "color"}
    written = sum(4.0 * table[row].written * runs[kernel] for kernel, row in rows.items())
    return written + float(one["stencil"])


def _hit_rates(found: dict[str, dict[str, Any]], size: int) -> Table:
    paper = published("purcell", "cache")
    low, high = paper.values["triangle_hit_rate"]
    rows: list[list[Cell]] = [
        [
            name,
            architecture,
            f"{low:.0%} to {high:.0%}",
            *(
                one[architecture]["data"].get(kind, {}).get("hit_rate")
                for kind in ("triangles", "lists", "grid", "shading")
            ),
            sum(kind["references"] for kind in one[architecture]["data"].values()),
        ]
        for name, one in found.items()
        for architecture in ("multipass", _TILED, "branching")
    ]
    return Table.of(
        "purcell-hit-rates",
        f"Hit rates of the cache, 64 KB direct-mapped: {paper.source}; {size} x {size}",
        [
            "view",
            "architecture",
            "triangles, published",
            "triangles",
            "lists",
            "grid",
            "shading",
            "references",
        ],
        rows,
        f"{_TILED.capitalize()}: the same passes over the image in tiles of 8 x 8 pixels, as "
        "rasterisers do, instead of row by row. The paper does not give its order.",
    )


def _others(runner: Runner, name: str) -> dict[str, float]:
    """Hit rates of triangle reads in other caches, on the branching machine."""
    size = min(runner.size(SIZE), _OTHERS_SIZE)

    def measure() -> dict[str, float]:
        walks = _walks(runner, name, size)
        caches = {
            f"{bytes_ >> 10} KB, {'full' if ways is None else ways} ways, {line} bytes": Cache(
                bytes_, line, ways, kinds=KIND_NAMES
            )
            for bytes_, line, ways in _variants()
        }
        takers = [functools.partial(_access, cache) for cache in caches.values()]
        feed_chunks(branching_references(walks), takers)
        return {text: one.counts["triangles"].hit_rate for text, one in caches.items()}

    found: dict[str, float] = runner.measure(f"{name}, other caches, {size} x {size}", measure)
    return found


def _variants() -> list[tuple[int, int, int | None]]:
    """Bytes, line and ways of the other caches."""
    values = published("purcell", "cache").values
    line, usual = values["line"], values["bytes"]
    return [
        *((kilobytes << 10, line, ways) for kilobytes in _SIZES for ways in _WAYS),
        *((usual, other, 1) for other in _LINES if other != line),
    ]


def _walks(runner: Runner, name: str, size: int) -> Walks:
    """Record the walks of a smaller image."""
    view = runner.view(name)
    return record(
        grid_tracer(runner, view), *view.rays(size), visits=True, progress=runner.progress
    )


def _varied_table(varied: dict[str, dict[str, float]]) -> Table:
    caches = list(next(iter(varied.values()), {}))
    return Table.of(
        "purcell-caches",
        f"Hit rate of triangle reads in other caches (branching, up to {_OTHERS_SIZE} x "
        f"{_OTHERS_SIZE})",
        ["cache", *varied],
        [[text, *(found[text] for found in varied.values())] for text in caches],
    )


def _curve(runner: Runner, name: str) -> dict[str, Any]:
    """Exact hit rates of fully associative caches of every size, from reuse distances."""
    size = min(runner.size(SIZE), _CURVE_SIZE)

    def measure() -> dict[str, Any]:
        walks = _walks(runner, name, size)
        line = published("purcell", "cache").values["line"]
        distances = ReuseDistances(line, kinds=KIND_NAMES)
        feed_chunks(branching_references(walks), [functools.partial(_access, distances)])
        curve = distances.curve(list(_CURVE_BYTES))
        return {"sizes": curve.sizes.tolist(), "hit_rates": curve.hit_rates.tolist()}

    found: dict[str, Any] = runner.measure(
        f"{name}, caches of every size, {size} x {size}", measure
    )
    return found


def _curve_plot(curves: dict[str, dict[str, Any]]) -> Plot:
    return Plot(
        "purcell-reuse",
        "Misses of fully associative caches of every size (branching, lines of 48 bytes)",
        "bytes",
        "share of accesses that miss",
        [
            Series(name, one["sizes"], [1.0 - rate for rate in one["hit_rates"]])
            for name, one in curves.items()
        ],
        log_x=True,
        log_y=True,
    )


def _claims(found: dict[str, dict[str, Any]]) -> list[Claim]:
    paper = published("purcell", "cache")
    low, _ = paper.values["triangle_hit_rate"]
    rates = {
        f"{name}, {architecture}": one[architecture]["data"]["triangles"]["hit_rate"]
        for name, one in found.items()
        for architecture in ("multipass", "branching")
    }
    totals = {name: _totals(one) for name, one in found.items()}
    gains = ", ".join(f"{name} {m:.2f} and {b:.2f}" for name, (m, b) in totals.items())
    return [
        Claim.judged(
            f"At least {low:.0%} of the triangle reads hit, on both architectures",
            paper.source,
            {case: rate >= low - 0.005 for case, rate in rates.items()},
            listed(rates, ".1%") + "; " + _tiled(found),
        ),
        Claim.judged(
            "The cache helps branching much more than multipass",
            paper.source,
            {name: branching < 0.5 * multipass for name, (multipass, branching) in totals.items()},
            "remaining bytes, multipass (state bypasses the cache) and branching: " + gains,
        ),
    ]


def _tiled(found: dict[str, dict[str, Any]]) -> str:
    """The effect of the ray order on the multipass machine."""
    rates = (
        f"{name} {one[_TILED]['data']['triangles']['hit_rate']:.1%}" for name, one in found.items()
    )
    return "multipass with rays in tiles instead of rows: " + ", ".join(rates)


def _totals(one: dict[str, Any]) -> tuple[float, float]:
    multipass, branching = _ratios(one, "multipass")[4], _ratios(one, "branching")[4]
    assert isinstance(multipass, float)
    assert isinstance(branching, float)
    return multipass, branching
