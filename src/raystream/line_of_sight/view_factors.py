"""View factors between patches, by ray casting."""

from __future__ import annotations

import math
import operator
from typing import Any, NamedTuple, TypedDict, Unpack

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import Hits
from raystream.core.instances import moved
from raystream.core.memory import check_memory
from raystream.core.scene_kinds import check_support
from raystream.jit.threads import Progress
from raystream.line_of_sight.balance import Shares, balanced
from raystream.line_of_sight.patches import (
    Emitter,
    Patches,
    make_patches,
    makes_ellipsoids,
    patch_ids,
)
from raystream.programs.cutouts import cutouts_of
from raystream.rendering.sampling.sampler import MAX_SAMPLES, Sampler
from raystream.scene.scene import Scene
from raystream.tracer import Tracer

__all__ = ["REPLICATES", "ViewFactors", "view_factors"]

#: Independent sets of samples of a patch: the standard error is that of their mean.
REPLICATES = 16

#: Most rays that are traced at once: about 400 bytes each.
_BLOCK = 1 << 17

#: Matrices of N x N numbers, and while factors are balanced.
_MATRICES, _BALANCED_MATRICES = 2, 16


class _Tracing(TypedDict, total=False):
    """Options of how rays are traced."""

    cutouts: bool
    progress: Progress | None


class ViewFactors(NamedTuple):
    """View factors between N patches, and their standard errors.

    Attributes
    ----------
    factors : ndarray of shape (N, N), float64
        ``factors[i, j]`` is the share of the diffuse radiation from patch i that reaches patch j
        directly.
    standard_errors : ndarray of shape (N, N), float64
        Standard errors of the factors, at least 1 over the number of rays.
    outside : ndarray of shape (N,), float64
        Share that hits nothing and reaches the sky, for example.
    outside_errors : ndarray of shape (N,), float64
    other : ndarray of shape (N,), float64
        Share that hits what is in no patch, or the back of a patch.
    other_errors : ndarray of shape (N,), float64
    areas : ndarray of shape (N,), float64
        Area of one side, in squared scene units; of a patch with cut-outs, an estimate from the
        points at which its rays start.
    ray_counts : ndarray of shape (N,), int64
        Rays cast from each patch.
    """

    factors: NDArray[np.float64]
    standard_errors: NDArray[np.float64]
    outside: NDArray[np.float64]
    outside_errors: NDArray[np.float64]
    other: NDArray[np.float64]
    other_errors: NDArray[np.float64]
    areas: NDArray[np.float64]
    ray_counts: NDArray[np.int64]


def view_factors(
    scene: Scene | Tracer,
    patches: Any = None,
    *,
    rays: int = 1 << 14,
    target_error: float | None = None,
    max_rays: int = 1 << 24,
    two_sided: bool = False,
    reciprocity: bool = False,
    seed: int = 0,
    **tracing: Unpack[_Tracing],
) -> ViewFactors:
    """Compute the view factors (form factors, configuration factors) between patches.

    Parameters
    ----------
    scene : Scene or Tracer
        A scene is traced with ``structure="bvh"`` on the CPU.
    patches : array_like of shape (F,), int, optional
        The patch of each triangle or sphere, by prim_id: 0 to N - 1, or -1 for those that only
        block. In a scene with instances, of each triangle and sphere of the first one, then of
        the next, and so on; in each, meshes come first, then height fields, then spheres
        [default: each mesh is a patch, as in ``mesh_id``; or each instance].
    rays : int
        Rays from each patch, at least 16; rounded up to 16 times a power of two.
    target_error : float, optional
        Double the rays of a patch until the standard errors of its row, `outside` and `other`
        included, are at most this [default: cast `rays` rays].
    max_rays : int
        Maximum number of rays per patch, at most 2**28; if it is reached first, the standard
        errors exceed `target_error`.
    two_sided : bool
        Whether patches radiate and receive on both sides [default: on the front, from which
        their triangles' vertices run counter-clockwise; on the outside of spheres].
    reciprocity : bool
        Change the estimates as little as possible, compared with their standard errors, so that
        ``areas[i] * factors[i, j]`` is symmetric, and rows still sum to 1: see Notes.
    seed : int
        Seed of the samples, 0 to 2**32 - 1.
    **tracing
        ``cutouts`` (bool): whether surfaces neither radiate nor receive, and hide nothing, where
        they are cut out: where the opacity of their material is below its ``alpha_cutoff``, or
        below a half without one; False makes all of it surface [default: True]. ``progress``
        (callable): called with (patches done, patches).

    Returns
    -------
    ViewFactors
        ``factors.sum(axis=1) + outside + other`` is 1. In a closed enclosure of patches that face
        inward, `outside` and `other` are 0.

    Raises
    ------
    ValueError
        If a patch has no area, or a shape or number is wrong; or if there are cut-outs, and the
        tracer counts.
    TypeError
        If `patches` are not integers, or `scene` is neither a scene nor a tracer.
    MemoryError
        If the matrices do not fit into memory: 16 bytes for each pair of patches, 128 with
        `reciprocity`.

    Notes
    -----
    Rays start at points distributed uniformly over a patch, in cosine-distributed directions about
    its normal; the share of them that reaches a patch first is the view factor. Samples are Sobol
    points with Owen scrambling, in four dimensions, in 16 independent replicates: the standard
    error is that of the replicates' mean (15 degrees of freedom: the factor is within 2.13
    standard errors with a probability of about 95 %). It falls faster than one over the square
    root of the number of rays. Results depend on the scene, `patches`, `rays` and `seed`, not on
    threads or the structure.

    Rays start off the surface by an error bound, as those of `Hits.spawn`, and 8 times that bound
    away from the edges of their triangle: they do not leave a closed enclosure through a corner of
    10 degrees or more.

    On spheres that instances stretch, points are chosen among those of the spheres. `areas` of
    their patches are estimated, as are those of patches with cut-outs.

    With `reciprocity`, the two estimates of each exchange are averaged, weighted by their inverse
    variances, and then changed, as far as their variances allow, until rows sum to 1; factors that
    would be negative become 0, and those for which no ray was found from either side stay 0. The
    standard errors are then those of the averages.

    Examples
    --------
    Two unit squares that face each other at distance 1:

    >>> import raystream as rs
    >>> square = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    >>> low = rs.Mesh(square, [[0, 1, 2], [0, 2, 3]])
    >>> high = rs.Mesh([[x, y, 1] for x, y, _ in square], [[0, 2, 1], [0, 3, 2]])
    >>> found = rs.view_factors(rs.Scene([low, high]), target_error=1e-4)
    >>> [round(float(share), 3) for share in (found.factors[0, 1], found.outside[0])]
    [0.2, 0.8]

    The exact factor is 0.19982.
    """
    if not isinstance(scene, Scene | Tracer):
        raise TypeError(f"scene: expected a Scene or Tracer, got {type(scene).__name__}")
    cutouts, progress = _tracing(**tracing)
    tracer = scene if isinstance(scene, Tracer) else Tracer(scene)
    per_replicate = _power_of_two("rays", rays)
    most = max(_power_of_two("max_rays", max_rays), per_replicate)
    if target_error is None:
        most = per_replicate
    elif not target_error > 0.0:
        raise ValueError(f"target_error: expected a number above 0, got {target_error}")
    sampler = Sampler.of("sobol", seed)
    triangles = tracer.structure.triangles
    check_support("view_factors", triangles)
    ids = patch_ids(patches, triangles)
    count = int(ids.max(initial=-1)) + 1
    matrices = _BALANCED_MATRICES if reciprocity else _MATRICES
    check_memory(8 * matrices * count**2, f"view_factors: {count:,} x {count:,} factors would")
    opacity = cutouts_of(tracer, cutouts)
    patches_made = make_patches(ids, triangles)
    number_count = 5 if makes_ellipsoids(triangles) else 4
    caster = _Caster(tracer, patches_made, sampler, bool(two_sided), opacity, number_count)
    areas = caster.patches.areas.copy()
    shares = Shares(*(np.empty((count, width)) for width in (count, count, 2, 2)))
    ray_counts = np.zeros(count, np.int64)
    for patch in range(count):
        row, errors, ray_counts[patch], area_share = caster.row(
            patch, per_replicate, most, target_error or math.inf
        )
        areas[patch] *= area_share
        shares.factors[patch], shares.sinks[patch] = row[:count], row[count:]
        shares.errors[patch], shares.sink_errors[patch] = errors[:count], errors[count:]
        if progress:
            progress(patch + 1, count)
    if reciprocity and count:
        shares = balanced(shares, areas)
    return ViewFactors(
        shares.factors,
        shares.errors,
        shares.sinks[:, 0],
        shares.sink_errors[:, 0],
        shares.sinks[:, 1],
        shares.sink_errors[:, 1],
        areas,
        ray_counts,
    )


def _tracing(
    *, cutouts: bool = True, progress: Progress | None = None
) -> tuple[bool, Progress | None]:
    """The options of `_Tracing`; TypeError for others."""
    return cutouts, progress


def _power_of_two(name: str, rays: int) -> int:
    """Samples of a replicate for this many rays."""
    count = operator.index(rays)
    if not REPLICATES <= count <= REPLICATES * MAX_SAMPLES:
        most = REPLICATES * MAX_SAMPLES
        raise ValueError(f"{name}: expected {REPLICATES} to {most:,}, got {count:,}")
    return 1 << (-(-count // REPLICATES) - 1).bit_length()


class _Caster(NamedTuple):
    """Casts the rays of patches."""

    tracer: Tracer
    patches: Patches
    sampler: Sampler
    two_sided: bool
    opacity: Any
    number_count: int

    def row(
        self, patch: int, samples: int, most: int, target: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], int, float]:
        """Shares of a patch's rays with their standard errors, and the number of rays.

        Parameters
        ----------
        patch : int
        samples, most : int
            Samples of each replicate, at first and at most.
        target : float
            The standard errors wanted.

        Returns
        -------
        shares, errors : ndarray of shape (N + 2,), float64
            Of the patches, of nothing, and of triangles of no patch.
        ray_count : int
        area_share : float
            Share of the patch's points that are not cut out.

        Raises
        ------
        ValueError
            If all are.
        """
        width = len(self.patches.areas) + 2
        counts, cast = np.zeros((REPLICATES, width), np.int64), np.zeros(REPLICATES, np.int64)
        emitter = Emitter(self.patches, patch, self.two_sided, self.opacity)
        done = 0
        while True:
            for begin in range(done, samples, _BLOCK // REPLICATES):
                end = min(begin + _BLOCK // REPLICATES, samples)
                streams = patch * REPLICATES + np.arange(REPLICATES)
                numbers = self.sampler.numbers(
                    np.repeat(streams % 2**32, end - begin),
                    np.tile(np.arange(begin, end), REPLICATES),
                    count=self.number_count,
                )
                found, cast_now = self._count(emitter.rays(numbers), width)
                counts += found
                cast += cast_now
            done = samples
            total = int(cast.sum())
            if total == 0:
                raise ValueError(
                    f"patches: patch {patch} is cut out at all {REPLICATES * samples:,} points at "
                    "which its rays would start; use -1 for its triangles, or cutouts=False"
                )
            shares = counts.sum(axis=0) / total
            # The replicates' mean has this standard error; less than a ray is not resolved. A share
            # of a number of rays that varies is a ratio: what counts is how far replicates are from
            # the share of their own rays.
            spread = (counts - shares * (cast - samples)[:, None]).std(axis=0, ddof=1)
            errors = spread / (total / REPLICATES * math.sqrt(REPLICATES))
            errors = np.maximum(errors, 1.0 / total)
            if errors.max() <= target or samples >= most:
                return shares, errors, total, total / (REPLICATES * samples)
            samples *= 2

    def _count(
        self, rays: tuple[NDArray[np.float64], NDArray[np.float64]], width: int
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Rays by replicate, of which each has as many in a row, and by what they meet first.

        And the number of rays of each replicate: those without a direction are not cast.
        """
        on_hit = self.opacity and self.opacity.on_hit
        hits, triangles = self.tracer.first_hit(*rays, on_hit=on_hit), self.patches.triangles
        numbers = triangles.numbers_of(hits.prim_id, hits.instance_id)
        rows = np.flatnonzero(numbers >= 0)
        hit = numbers[rows]
        found = self.patches.ids[hit]
        if not self.two_sided:
            facing = np.einsum("nk,nk->n", self.patches.normals[hit], rays[1][rows]) < 0.0
            if triangles.has_primitives:
                facing |= _is_outside(triangles, hits[rows], rays[0][rows])
            found = np.where(facing, found, -1)
        target = np.full(len(numbers), width - 2)
        target[rows] = np.where(found < 0, width - 1, found)
        replicates = np.arange(len(numbers)) // (len(numbers) // REPLICATES)
        is_cast = ~np.isnan(rays[1][:, 0])
        cells = (replicates * width + target)[is_cast]
        bins = np.bincount(cells, minlength=REPLICATES * width).reshape(REPLICATES, width)
        return bins, bins.sum(axis=1)


def _is_outside(triangles: Any, hits: Hits, origins: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether rays that start here and meet a sphere first meet its outside."""
    rows = triangles.sphere_rows(hits.prim_id)
    outside = rows >= 0
    spheres, some, starts = triangles.spheres, rows[outside], origins[outside]
    if triangles.instances is not None:
        starts = moved(triangles.instances.inverses[hits.instance_id[outside]], starts)
    distances = np.linalg.norm(starts - spheres.centers[some], axis=1)
    outside[outside] = distances > spheres.radii[some]
    return outside
