"""raystream itself, as a contender."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream._version import __version__
from raystream.bench.contenders.base import (
    AllHits,
    Closest,
    Contender,
    FirstHits,
    Geometry,
    Points,
    Rays,
)
from raystream.jit.threads import set_thread_count
from raystream.scene.scene import Scene
from raystream.structures import names_with
from raystream.tracer import Tracer


class Raystream(Contender):
    """A `Tracer` with the given options."""

    has_instances = True
    is_watertight = True

    def __init__(self, threads: int, options: Mapping[str, Any]) -> None:
        self.version = __version__
        set_thread_count(threads)
        self._options = dict(options)
        is_plain = options.get("machine", "branching") == "branching"
        is_plain = is_plain and options.get("device", "cpu") in ("cpu", "cuda")
        if is_plain and options.get("structure", "bvh") in names_with("nearest"):
            self.queries = self.queries | {"closest"}
        self._tracer: Tracer | None = None

    @property
    def tracer(self) -> Tracer:
        """The tracer that was built."""
        assert self._tracer is not None, "build first"
        return self._tracer

    def build(self, geometry: Geometry) -> None:
        """Make a scene from the arrays, and its structure."""
        objects = [Scene.from_arrays(vertices, faces) for vertices, faces in geometry.objects()]
        scene, placed = objects[0], geometry.placed
        if placed is not None:
            scene = Scene.instances(objects, placed.transforms, placed.object_ids)
        self._tracer = Tracer(scene, **self._options)

    def release(self) -> None:
        """Free the structure."""
        self._tracer = None

    def first_hit(self, rays: Rays, mode: str) -> FirstHits:  # noqa: ARG002
        """Find the nearest hit of each ray."""
        hits = self.tracer.first_hit(rays.origins, rays.directions, t_max=rays.t_max)
        return FirstHits(hits.t, hits.prim_id)

    def any_hit(self, rays: Rays, mode: str) -> NDArray[np.bool_]:  # noqa: ARG002
        """Test whether each ray hits anything."""
        return self.tracer.any_hit(rays.origins, rays.directions, t_max=rays.t_max)

    def multi_hit(self, rays: Rays, mode: str) -> AllHits:  # noqa: ARG002
        """Find all hits of each ray, sorted."""
        hits = self.tracer.multi_hit(rays.origins, rays.directions, t_max=rays.t_max)
        return AllHits(hits.ray_splits, hits.t, hits.prim_id)

    def closest_point(self, points: Points, mode: str) -> Closest:  # noqa: ARG002
        """Find the nearest point of the triangles to each point."""
        found = self.tracer.closest_point(points.points)
        return Closest(found.distance, found.positions)
