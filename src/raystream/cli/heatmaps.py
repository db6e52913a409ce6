"""Heat maps: ``raystream render --heatmap``."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

import typer

from raystream.cli import options
from raystream.cli.messages import BadInputError

if TYPE_CHECKING:
    from raystream.rendering.heatmap import Heatmap

__all__ = ["Maximum", "What", "check_heatmap", "heatmap_figures"]

What = Annotated[
    str | None,
    typer.Option(
        "--heatmap",
        help="Instead of a picture of the scene, what the first hit of each pixel costs: "
        f"{' or '.join(options.HEATMAPS)}, in false colours, with a scale below.",
        metavar="WHAT",
        show_default=False,
        callback=options.one_of(options.HEATMAPS),
        autocompletion=options.complete(options.HEATMAPS),
    ),
]
Maximum = Annotated[
    float | None,
    typer.Option(
        help="With --heatmap: the top of the scale; the largest count without it.",
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
    """Refuse what does not go with a heat map, and let the tracer count for one.

    Parameters
    ----------
    what, maximum
        Options as given; None for those that were not.
    others : mapping
        Those that only a picture takes, by name, as given.
    chosen : dict
        Options of `Tracer`; gets ``counters``.

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
            raise BadInputError(
                f"--{name.replace('_', '-')}: not with --heatmap, which shows counts"
            )
    if chosen.setdefault("counters", True) is not True:
        raise BadInputError("--option: --heatmap needs counters")


def heatmap_figures(heat: Heatmap) -> dict[str, Any]:
    """Figures about a heat map, as ``--json`` prints them.

    Returns
    -------
    dict
        ``heatmap``: what it shows; ``counts``: ``mean``, ``most`` and ``total`` of each; of a
        multipass machine ``passes``: their ``count`` and ``optimal_count``.
    """
    counts = {
        name: {"mean": round(cost.mean, 6), "most": cost.most, "total": cost.total}
        for name, cost in heat.costs.items()
    }
    figures: dict[str, Any] = {"heatmap": heat.what, "counts": counts}
    if heat.passes is not None:
        figures["passes"] = dataclasses.asdict(heat.passes)
    return figures
