"""Heat maps: ``raystream render --heatmap``."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

from raystream.cli import options
from raystream.cli.console import BadInputError
from raystream.cli.tracer_options import TracerArguments

if TYPE_CHECKING:
    from raystream.rendering.heatmap import Heatmap

#: Other options of ``raystream render`` that do not apply to heat maps.
IMAGE_ONLY = (
    *("mode", "exposure", "tone", "environment", "sun", "lights", "layers", "denoise", "cluster"),
    *("max_bounces", "quality", "noise", "time_limit", "sampler", "resume"),
)


@dataclasses.dataclass(frozen=True)
class HeatmapOptions:
    """Options of a heat map."""

    heatmap: Annotated[
        str | None,
        options.choice(
            options.HEATMAPS,
            "Instead of an image of the scene, draw the cost of each pixel's first hit: "
            f"{' or '.join(options.HEATMAPS)}, in false colours, with a scale below.",
        ),
    ] = None
    maximum: Annotated[
        float | None,
        options.positive_number(
            "COUNT", "With --heatmap: top of the scale [default: the largest count]"
        ),
    ] = None

    def check(self, given: Mapping[str, Any], chosen: TracerArguments) -> None:
        """Reject options that contradict a heat map, and enable the tracer's counters for one.

        Parameters
        ----------
        given : mapping
            Options given on the command line, by name.
        chosen : TracerArguments
            Its options get ``counters``.

        Raises
        ------
        BadInputError
            If options contradict each other.
        """
        if self.heatmap is None:
            if self.maximum is not None:
                raise BadInputError("--maximum: only with --heatmap")
            return
        for name in IMAGE_ONLY:
            if name in given:
                raise BadInputError(
                    f"--{name.replace('_', '-')}: cannot be combined with --heatmap"
                )
        if chosen.options.setdefault("counters", True) is not True:
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
