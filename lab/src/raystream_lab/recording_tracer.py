"""A tracer that records its queries, to count or replay the rays of an image."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import Hits, MultiHits
from raystream.scene.scene import Scene
from raystream.structures import Structure
from raystream.tracer import Tracer


class RecordedQuery(NamedTuple):
    """A query.

    Attributes
    ----------
    query : {"first_hit", "any_hit", "multi_hit"}
    ray_count : int
    origins, directions : ndarray of shape (N, 3), or None
        The rays, if recorded.
    """

    query: str
    ray_count: int
    origins: NDArray[Any] | None
    directions: NDArray[Any] | None


class RecordingTracer(Tracer):
    """A tracer that records its queries.

    Parameters
    ----------
    scene : Scene
    structure : str
    keep_rays : bool
        Record the rays themselves, not only their number.
    **options
        As for `Tracer`.

    Attributes
    ----------
    queries : list of RecordedQuery
        In the order of the calls, which may come from several threads.
    """

    def __init__(
        self, scene: Scene, structure: str = "bvh", *, keep_rays: bool = False, **options: Any
    ) -> None:
        super().__init__(scene, structure, **options)
        self.keep_rays = keep_rays

    def _set(self, scene: Scene | None, structure: Structure) -> None:
        super()._set(scene, structure)
        self.keep_rays = False
        self.queries: list[RecordedQuery] = []

    def first_hit(self, origins: Any, directions: Any, **options: Any) -> Hits:
        """See `Tracer.first_hit`."""
        self._record("first_hit", origins, directions)
        return super().first_hit(origins, directions, **options)

    def any_hit(self, origins: Any, directions: Any, **options: Any) -> NDArray[np.bool_]:
        """See `Tracer.any_hit`."""
        self._record("any_hit", origins, directions)
        return super().any_hit(origins, directions, **options)

    def multi_hit(self, origins: Any, directions: Any, **options: Any) -> MultiHits:
        """See `Tracer.multi_hit`."""
        self._record("multi_hit", origins, directions)
        return super().multi_hit(origins, directions, **options)

    def _record(self, query: str, origins: Any, directions: Any) -> None:
        count = math.prod(np.broadcast_shapes(np.shape(origins), np.shape(directions))[:-1])
        rays = (np.array(one).reshape(-1, 3) for one in (origins, directions))
        kept = rays if self.keep_rays else (None, None)
        self.queries.append(RecordedQuery(query, count, *kept))
