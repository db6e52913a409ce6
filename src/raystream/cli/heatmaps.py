"""Heat maps: ``raystream render --heatmap``."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

import typer

from raystream.cli import options
from raystream.cli.console import BadInputError

if TYPE_CHECKING:
    from raystream.rendering.heatmap import Heatmap

__all__ = ["HeatmapKind", "Maximum", "check_heatmap", "heatmap_figures"]

HeatmapKind = Annotated[
    str | None,
    typer.Option(
        "--heatmap",
        help="Instead of an image of the scene, draw the cost of each pixel's first hit: "
        f"{' or '.join(options.HEATMAPS)}, in false colours, with a scale below.",
        metavar="NAME",
        show_default=False,
        callback=options.one_of(options.HEATMAPS),
        autocompletion=options.complete(options.HEATMAPS),
    ),
]
Maximum = Annotated[
    float | None,
    typer.Option(
        help="With --heatmap: the top of the scale [default: the largest count]",
        metavar="COUNT",
        show_default=False,
        callback=options.positive_if_given,
    ),
]


def check_heatmap(
    what: str | None,
    maximum: float | None,
    others: Mapping[str, Any],
    chosen: dict[str, Any],
) -> None:
    """Reject options that contradict a heat map, and enable the tracer's counters for one.

    Parameters
    ----------
    what, maximum
        Options as given; None if omitted.
    others : mapping
        Options that apply only to images, by name, as given.
    chosen : dict
        `Tracer` options; gets ``counters``.

    Raises
    ------
    BadInputError
        If options contradict each other.
    """
    if what is None:
        if maximum is not None:
            raise BadInputError("--maximum: only with --heatmap")
        return
    for name, value in others.items():
        if value is not None:
            raise BadInputError(f"--{name.replace('_', '-')}: cannot be combined with --heatmap")
    if chosen.setdefault("counters", True) is not True:
        raise BadInputError("--option: --heatmap needs counters=true")


def heatmap_figures(heat: Heatmap) -> dict[str, Any]:
    """Return the figures of a heat map that ``--json`` prints.

    Returns
    -------
    dict
        ``heatmap``: the quantity shown; ``counts``: ``mean``, ``most`` and ``total`` of each; for
        a multipass machine ``passes``: ``count`` and ``optimal_count``.
    """
    counts = {
        name: {"mean": round(cost.mean, 6), "most": cost.most, "total": cost.total}
        for name, cost in heat.costs.items()
    }
    figures: dict[str, Any] = {"heatmap": heat.what, "counts": counts}
    if heat.passes is not None:
        figures["passes"] = dataclasses.asdict(heat.passes)
    return figures
