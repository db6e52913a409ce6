"""Progressive heat maps."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from raystream.jit.threads import Progress
from raystream.kernels.tally import COLUMNS
from raystream.rendering.camera_paths import camera_paths
from raystream.rendering.color import encode_srgb
from raystream.rendering.false_colors import color_ramp, draw_counts
from raystream.rendering.heatmap import Heatmap, RayCost
from raystream.rendering.integrator import RenderContext
from raystream.viewer.adaptive_resolution import Cost
from raystream.viewer.messages import Message
from raystream.viewer.progressive_images import Drawing, ProgressiveImage
from raystream.viewer.settings import DisplaySettings

#: Rays traced at a time: limits memory to about 40 MB.
_RAYS_AT_ONCE = 1 << 18

#: Number of ramp colours sent to pages.
_RAMP_LENGTH = 33


class HeatmapImage(ProgressiveImage):
    """A heat map of the cost of each pixel's first hit.

    Parameters
    ----------
    context : RenderContext
        Of a tracer with counters, with one sample per pixel.
    what : str
        A name in `HEATMAPS`.
    cost : Cost
    """

    def __init__(self, context: RenderContext, what: str, cost: Cost) -> None:
        size = context.width, context.height
        super().__init__(size, 1, cost, max(1, _RAYS_AT_ONCE // context.width))
        self._context, self._what = context, what
        self._counts = np.zeros((self.height, self.width), np.float32)
        self._totals = dict.fromkeys(COLUMNS, 0)
        self._most = self._total = 0

    def _trace(self, rows: range, sample: int, progress: Progress) -> None:
        context, tracer = self._context, self._context.tracer
        size = self.width, self.height
        paths = camera_paths(context.camera, size, context.sampler, rows, sample)
        tracer.first_hit(paths.origins, paths.directions, progress=progress)
        counters = tracer.counters
        by_name = {"cells": counters.cells, "tests": counters.tests, "steps": counters.all_steps}
        counts = by_name[self._what]
        self._counts[rows.start : rows.stop] = counts.reshape(-1, self.width)
        self._most = max(self._most, int(counts.max()))
        self._total += int(counts.sum(dtype=np.int64))
        for name, total in counters.total.items():
            self._totals[name] += total

    def draw(self, display: DisplaySettings) -> Callable[[], Drawing]:
        """See `ProgressiveImage.draw`."""

        def draw() -> Drawing:
            drawn = draw_counts(self._counts, "", display.maximum)
            return Drawing(np.ascontiguousarray(drawn[: self.height]), _plain(display))

        return draw

    def draw_whole(self, display: DisplaySettings) -> Callable[[], Drawing]:
        """See `ProgressiveImage.draw_whole`; the scale adds to the height."""
        heat = Heatmap(
            self._what,
            self._counts,
            {self._what: RayCost(self._total / self._counts.size, self._most, self._total)},
            self._context.tracer.structure.name,
            None,
            display.maximum,
        )
        return lambda: Drawing(heat.image.pixels, _plain(display))

    def facts(self, display: DisplaySettings) -> Message:
        """See `ProgressiveImage.facts`."""
        rays = self._counts.size
        top = display.maximum or float(self._counts.max()) or 1.0
        return {
            "counters": {name: round(total / rays, 4) for name, total in self._totals.items()},
            "legend": {
                "what": self._what,
                "maximum": top,
                "mean": round(self._total / rays, 4),
                "most": self._most,
            },
        }


def _plain(display: DisplaySettings) -> DisplaySettings:
    """Replace exposure and tone: false colours are shown unchanged."""
    return display._replace(exposure=1.0, tone="linear")


@cache
def ramp() -> list[str]:
    """Return the colours of the scale, from 0 to its top, as CSS colours."""
    colors: NDArray[np.uint8] = encode_srgb(color_ramp(_RAMP_LENGTH))
    return [f"#{red:02x}{green:02x}{blue:02x}" for red, green, blue in colors.tolist()]
