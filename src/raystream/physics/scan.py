"""Tracing blocks of pulses: sub-rays, their echoes, and returns."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import MultiHits
from raystream.core.rays import RayBatch
from raystream.jit.threads import parallel_for
from raystream.physics.pulses import Echoes, Surfaces, follow_pulses, merge_echoes
from raystream.physics.thickness import direction_lengths
from raystream.programs.filters import Bound
from raystream.tracer import Tracer

#: Surfaces traced at first per ray, where some transmit.
_FIRST_HITS = 8

#: Rays per call of a kernel: about a millisecond.
_CHUNK = 1 << 13

#: Hits in instances whose normals are computed at a time: about 500 bytes each.
_ROWS = 1 << 17

_GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))


class Returns(NamedTuple):
    """Columns of `LidarReturns`."""

    ranges: NDArray[np.float64]
    positions: NDArray[np.float64]
    intensity: NDArray[np.float64]
    incidence_angle: NDArray[np.float64]
    prim_id: NDArray[np.int32]
    instance_id: NDArray[np.int32]


class Receiver(NamedTuple):
    """Properties of the emitter and receiver.

    Attributes
    ----------
    max_returns, sub_rays : int
    spread : float
        Tangent of half the angle of a pulse's cone.
    separation, min_range : float
        Scene units.
    """

    max_returns: int
    sub_rays: int
    spread: float
    separation: float
    min_range: float


class _Echoes(NamedTuple):
    """Echoes with energy, by increasing distance within a ray."""

    ray: NDArray[np.int64]
    t: NDArray[np.float32]
    energy: NDArray[np.float64]
    cosine: NDArray[np.float64]
    prim_id: NDArray[np.int32]
    instance_id: NDArray[np.int32]


class Scan:
    """A tracer and pulses, to be traced in blocks; `on_hit` is the filter of its queries."""

    def __init__(
        self,
        tracer: Tracer,
        batch: RayBatch,
        surfaces: Surfaces,
        receiver: Receiver,
        on_hit: Bound | None = None,
    ) -> None:
        self._tracer, self._batch, self._surfaces = tracer, batch, surfaces
        self._receiver, self._on_hit = receiver, on_hit

    def returns(self, rows: slice, counts: NDArray[np.int64], status: NDArray[np.uint8]) -> Returns:
        """Trace a block of pulses.

        Parameters
        ----------
        rows : slice
        counts, status : ndarray of shape (N,)
            Of all pulses; the block's numbers of returns and `RayStatus` are written.
        """
        lengths = direction_lengths(self._batch, rows)
        with np.errstate(invalid="ignore", divide="ignore"):
            axes = self._batch.directions[rows].astype(np.float64) / lengths[:, None]
        echoes = self._echoes(rows, axes, lengths, status)

        # Step 1: sort the echoes of a pulse by range, and group them into returns.
        pulse = echoes.ray // self._receiver.sub_rays
        ranges = echoes.t * lengths[pulse]
        order = np.lexsort((ranges, pulse))
        pulse, ranges, energy = pulse[order], ranges[order], echoes.energy[order]
        first = self._first_echoes(pulse, ranges, len(axes))
        number = np.cumsum(first) - 1

        # Step 2: sum up each return.
        pulse = pulse[first]
        total = np.bincount(number, energy, len(pulse))
        mean = np.bincount(number, energy * ranges, len(pulse)) / total
        intensity = total / self._receiver.sub_rays
        strongest = order[np.lexsort((-energy, number))[first]]

        # Step 3: keep the nearest of those detected.
        is_detected = intensity >= self._surfaces.threshold
        kept = np.flatnonzero(is_detected & (mean >= self._receiver.min_range))
        kept = kept[_rank(pulse[kept]) < self._receiver.max_returns]
        pulse, mean, strongest = pulse[kept], mean[kept], strongest[kept]
        counts[rows] = np.bincount(pulse, minlength=len(axes))
        return Returns(
            mean,
            self._batch.origins[rows][pulse] + mean[:, None] * axes[pulse],
            intensity[kept],
            np.degrees(np.arccos(echoes.cosine[strongest])),
            echoes.prim_id[strongest],
            echoes.instance_id[strongest],
        )

    def _first_echoes(
        self, pulse: NDArray[np.int64], ranges: NDArray[np.float64], pulse_count: int
    ) -> NDArray[np.bool_]:
        """Whether each echo, sorted by pulse and range, begins a return."""
        first = np.empty(len(ranges), np.bool_)
        splits = np.searchsorted(pulse, np.arange(pulse_count + 1))

        def body(begin: int, end: int) -> None:
            merge_echoes(begin, end, splits, ranges, self._receiver.separation, first)

        parallel_for(body, pulse_count, _CHUNK)
        return first

    def _echoes(
        self,
        rows: slice,
        axes: NDArray[np.float64],
        lengths: NDArray[np.float64],
        status: NDArray[np.uint8],
    ) -> _Echoes:
        """Echoes of all sub-rays of a block of pulses.

        Few surfaces are traced at first, and more for rays that pass through all of them.
        """
        batch, sub_rays = self._batch, self._receiver.sub_rays
        directions: NDArray[Any] = batch.directions[rows]
        if sub_rays > 1:
            axes = _cones(axes, sub_rays, self._receiver.spread)
            directions = axes * np.repeat(lengths, sub_rays)[:, None]
        rays = np.arange(len(axes))
        pulses = rays // sub_rays
        limit = _FIRST_HITS if self._surfaces.transmission.any() else 1
        parts: list[_Echoes] = []
        while len(rays) or not parts:
            hits = self._tracer.multi_hit(
                batch.origins[rows][pulses],
                directions[rays],
                t_min=batch.t_min[rows][pulses],
                t_max=batch.t_max[rows][pulses],
                max_hits=limit,
                crossings="surfaces",
                on_hit=self._on_hit,
                worlds=batch.worlds if batch.worlds is None else batch.worlds[rows][pulses],
            )
            if not parts:
                status[rows] = hits.status[::sub_rays]
            echoes = self._follow(axes[rays], hits)
            is_done = echoes.is_spent | (hits.counts < limit)
            if sub_rays == 1 and self._receiver.separation == self._receiver.min_range == 0.0:
                is_done |= echoes.detected_count >= self._receiver.max_returns
            kept = np.flatnonzero(is_done[hits.ray_id] & (echoes.energy > 0.0))
            parts.append(
                _Echoes(
                    rays[hits.ray_id[kept]],
                    hits.t[kept],
                    echoes.energy[kept],
                    echoes.cosine[kept],
                    hits.prim_id[kept],
                    hits.instance_id[kept],
                )
            )
            rays, pulses = rays[~is_done], pulses[~is_done]
            limit *= 4
        return _Echoes(*(np.concatenate(column) for column in zip(*parts, strict=True)))

    def _follow(self, axes: NDArray[np.float64], hits: MultiHits) -> Echoes:
        splits, prim_id, surfaces = hits.ray_splits, hits.prim_id, self._surfaces
        echoes = Echoes.empty(len(axes), len(prim_id))
        if surfaces.corners is None:  # the hits know their normals and materials
            _measure_cosines(axes, hits, echoes.cosine)
            surfaces = surfaces._replace(material_ids=hits.material_id)
            prim_id = np.arange(len(prim_id), dtype=np.int32)

        def body(begin: int, end: int) -> None:
            follow_pulses(begin, end, axes, splits, prim_id, surfaces, echoes)

        parallel_for(body, len(axes), _CHUNK)
        return echoes


def _measure_cosines(
    axes: NDArray[np.float64], hits: MultiHits, cosine: NDArray[np.float64]
) -> None:
    """Write cosines of angles of incidence."""
    for first in range(0, len(cosine), _ROWS):
        rows = slice(first, min(first + _ROWS, len(cosine)))
        normals = hits.part(rows)._world_normals()
        along = np.einsum("nk,nk->n", normals, axes[hits.ray_id[rows]])
        cosine[rows] = np.minimum(np.abs(along), 1.0)


def _rank(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """Position within each run of equal values, in a sorted array."""
    begins = np.searchsorted(values, values)
    return np.arange(len(values)) - begins


def _cones(axes: NDArray[np.float64], count: int, spread: float) -> NDArray[np.float64]:
    """Unit directions around each axis, evenly over a disk: (N, 3) gives (N * count, 3).

    They lie on a spiral of golden angles (Vogel, "A Better Way to Construct the
    Sunflower Head", Mathematical Biosciences 44, 1979).
    """
    # Step 1: two directions perpendicular to each axis.
    other = np.eye(3)[np.abs(axes).argmin(axis=1)]
    with np.errstate(invalid="ignore"):
        across = np.cross(axes, other)
        across /= np.linalg.norm(across, axis=1, keepdims=True)
    along = np.cross(axes, across)

    # Step 2: the spiral.
    place = np.arange(count)
    radius = spread * np.sqrt((place + 0.5) / count)
    x, y = radius * np.cos(_GOLDEN_ANGLE * place), radius * np.sin(_GOLDEN_ANGLE * place)
    rays = axes[:, None] + x[:, None] * across[:, None] + y[:, None] * along[:, None]
    rays /= np.sqrt(1.0 + radius * radius)[:, None]
    return rays.reshape(-1, 3)
