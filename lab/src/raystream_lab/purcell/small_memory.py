"""Geometry in a small memory: the loads of a page cache (Purcell 2002, section 5.1)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from raystream_lab.caches import ReuseDistances, feed_chunks
from raystream_lab.diffuse_bounces import bounce_rays
from raystream_lab.published import published
from raystream_lab.purcell.image_counts import SIZE, grid_of, grid_tracer
from raystream_lab.purcell.texture_cache import KIND_NAMES
from raystream_lab.results import Cell, Claim, Plot, Result, Series, Table, listed
from raystream_lab.runner import Runner
from raystream_lab.views import View
from raystream_lab.walks import ReferenceChunk, Textures, Walks, branching_references, record

_VIEWS = ("forest inside", "building inside")

_SIZE = 512

#: Bytes per page.
_PAGE = 4096

#: Memory of the card in megabytes.
_MEGABYTES = (1, 2, 4, 8, 16, 32, 64, 128, 256, 512)

#: Ray orders: an image by rows or in tiles, and the diffuse bounces of its rays.
_ORDERS = ("rows", "tiles", "bounces")


def small_memory(runner: Runner) -> Result:
    """Pages loaded by memory size, for coherent and for secondary rays."""
    result = Result()
    rows: list[list[Cell]] = []
    size = min(runner.size(SIZE), _SIZE)
    place = published("purcell", "memory")
    board, (least, most) = place.values["board_megabytes"], place.values["scene_megabytes"]
    shown = (4, 16, board, 256)
    megabytes_of: dict[str, float] = {}
    for name, found in result.available(_VIEWS, lambda name: _by_order(runner, name, size)):
        for order, one in found.items():
            at = dict(zip(_MEGABYTES, one["loaded"], strict=True))
            megabytes_of[name.split()[0]] = one["scene"] / 2**20
            rows.append(
                [
                    name,
                    order,
                    one["rays"],
                    one["scene"] / 2**20,
                    one["touched"] / 2**20,
                    *(at[megabytes] / one["rays"] for megabytes in shown),
                ]
            )
        result.plots.append(_plot(name, found))
    result.tables = [
        Table.of(
            "purcell-memory",
            f"Geometry in a small memory: {place.source}; up to {_SIZE} x {_SIZE} rays",
            [
                "view",
                "rays",
                "count",
                "scene, MB",
                "touched, MB",
                *(f"bytes per ray, {megabytes} MB" for megabytes in shown),
            ],
            rows,
            "The scene's textures (grid, lists, vertices, shading data) are in a large memory; a "
            "smaller one caches the most recently used pages of 4096 bytes. Bytes per ray: "
            "loaded bytes, including first loads. Touched: pages that any ray needs.",
            f"The paper's largest scenes take {least} to {most} MB, and its card has {board}.",
        )
    ]
    result.claims = [
        Claim.judged(
            f"The large scenes take {least} to {most} MB of texture memory",
            place.source,
            {name: least <= one <= most for name, one in megabytes_of.items()},
            "MB in the paper's layout: " + listed(megabytes_of, ".0f"),
        ),
        Claim.judged(
            f"... and do not fit on a card of {board} MB",
            place.source,
            {name: one > board for name, one in megabytes_of.items()},
            "the same sizes",
        ),
    ]
    return result


def _by_order(runner: Runner, name: str, size: int) -> dict[str, dict[str, Any]]:
    return {order: _measure(runner, name, order, size) for order in _ORDERS}


def _measure(runner: Runner, name: str, order: str, size: int) -> dict[str, Any]:
    def measure() -> dict[str, Any]:
        view = runner.view(name)
        walks = _walks(runner, view, order, size)
        pages = ReuseDistances(_PAGE, kinds=KIND_NAMES)
        feed_chunks(
            _references(walks, order),
            [lambda chunk: pages.access(chunk.addresses, chunk.kinds, chunk.words * np.uint8(4))],
        )
        misses = pages.misses([megabytes << 20 for megabytes in _MEGABYTES])
        return {
            "rays": len(walks),
            "scene": Textures.of(grid_of(grid_tracer(runner, view)), 0).byte_count,
            "touched": pages.line_count * _PAGE,
            "loaded": [int(count) * _PAGE for count in misses],
        }

    found: dict[str, Any] = runner.measure(f"{name}, {order}, {size} x {size}", measure)
    return found


def _walks(runner: Runner, view: View, order: str, size: int) -> Walks:
    tracer = grid_tracer(runner, view)
    origins, directions = view.rays(size)
    if order == "bounces":
        hits = tracer.first_hit(origins, directions)
        origins, directions = bounce_rays(hits, directions)
    return record(tracer, origins, directions, visits=True, progress=runner.progress)


def _references(walks: Walks, order: str) -> Iterator[ReferenceChunk]:
    return branching_references(walks, order="tiles" if order == "tiles" else "rows")


def _plot(name: str, found: dict[str, dict[str, Any]]) -> Plot:
    return Plot(
        f"purcell-memory-{name.replace(' ', '-')}",
        f"{name}: bytes loaded by memory size, pages of 4096 bytes",
        "memory, MB",
        "bytes loaded per ray",
        [
            Series(order, list(_MEGABYTES), [loaded / one["rays"] for loaded in one["loaded"]])
            for order, one in found.items()
        ],
        log_x=True,
        log_y=True,
    )
