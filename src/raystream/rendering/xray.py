"""xray: all surfaces along each ray at once (Rayforce 2013), as sheets or as solids.

As sheets, each surface covers part of those behind it. As solids, with `absorption`, the image
is that of an X-ray camera: white light attenuated by closed meshes (Beer-Lambert law); unpaired
crossings are ignored. Where meshes overlap, both attenuate it, or with ``nested="inner"`` the
smaller one.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import RaystreamWarning
from raystream.physics.attenuation import attenuation
from raystream.physics.segments import Rules, find_segments
from raystream.rendering.arguments import check_number
from raystream.rendering.integrator import Band, Integrator, PathStream
from raystream.rendering.shading.streams import Paths
from raystream.rendering.shading.transparency import composite_hits
from raystream.rendering.surfaces import tables_at

#: Hits in instances whose triangles are copied at once.
_PLACED_HITS = 1 << 18


def _blocks(splits: NDArray[np.int64], most: int) -> Iterator[tuple[slice, slice]]:
    """Consecutive rays with about this many hits, and the rows of their hits."""
    first, count = 0, len(splits) - 1
    while first < count:
        wanted = int(splits[first]) + most
        end = max(first + 1, int(np.searchsorted(splits, wanted, side="right")) - 1)
        end = min(end, count)
        yield slice(first, end), slice(int(splits[first]), int(splits[end]))
        first = end


def composite_surfaces(stream: PathStream, band: Band) -> PathStream:
    """Stage: find all surfaces along the rays, and composite them; the paths end."""
    context, paths = band.context, stream.paths
    if context.options["absorption"] is None:
        # A surface counts once at an edge, not once per triangle.
        rays = paths.origins, paths.directions
        hits = context.tracer.multi_hit(*rays, crossings="surfaces", on_hit=context.filter(*rays))
        # With instances, the tables of the hits take ten times the memory of the hits.
        most = len(hits.t) if context.objects is None else _PLACED_HITS
        for some, rows in _blocks(hits.ray_splits, most):
            part = hits if context.objects is None else hits.part(rows)
            tables, (_, *columns), _kept = tables_at(context, part)
            composite_hits(
                Paths._make(column[some] for column in paths),
                hits.ray_splits[some.start : some.stop + 1] - rows.start,
                tuple(columns),
                tables,
                context.options["opacity"],
                context.punctual,
                band.first_pixel,
                band.radiance,
            )
    else:
        directions = paths.directions.astype(np.float64)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        displaces = context.options["nested"] == "inner"
        batch, rules = (
            context.tracer.structure.ray_batch(paths.origins, directions),
            Rules(displaces=displaces),
        )
        found, overlaps = find_segments(context.tracer, batch, rules)
        if overlaps and not displaces:  # in the same words for all bands
            text = "xray: meshes overlap, and both absorb there; nested='inner' lets only one"
            warnings.warn(text, RaystreamWarning, stacklevel=2)
        passed = attenuation(found, context.options["absorption"], incomplete="ignore")
        band.radiance[paths.pixels - band.first_pixel] += passed[:, None].astype(np.float32)
    return PathStream(paths.first(0))


def _check(options: Mapping[str, Any]) -> Mapping[str, Any]:
    opacity, absorption = check_number("opacity", options["opacity"]), options["absorption"]
    if not 0.0 <= opacity <= 1.0:
        raise ValueError(f"opacity: expected 0 to 1, got {opacity}")
    if absorption is not None:
        absorption = check_number("absorption", absorption)
        if not (math.isfinite(absorption) and absorption >= 0.0):
            raise ValueError(f"absorption: expected a number of at least 0, got {absorption}")
    if options["nested"] not in ("both", "inner"):
        raise ValueError(f"nested: expected 'both' or 'inner', got {options['nested']!r}")
    return {"opacity": opacity, "absorption": absorption, "nested": options["nested"]}


XRAY = Integrator(
    "xray",
    "all surfaces along each ray, front to back (Rayforce 2013)",
    (composite_surfaces,),
    {"opacity": 0.2, "absorption": None, "nested": "both"},
    _check,
)
