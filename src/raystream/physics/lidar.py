"""LiDAR: pulses of light and their returns."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.checks import check_least
from raystream.core.hits import RayRows
from raystream.core.scene_kinds import check_support
from raystream.jit.threads import Progress
from raystream.physics.group_values import group_values
from raystream.physics.library_results import LibraryLidarReturns, in_library_of
from raystream.physics.pulses import Surfaces
from raystream.physics.scan import Receiver, Returns, Scan
from raystream.programs.cutouts import cutouts_of
from raystream.tracer import Tracer

__all__ = ["LidarReturns", "lidar_returns"]

#: Widest cone of a pulse, degrees.
MAX_DIVERGENCE = 90.0

#: Sub-rays per block: bounds the memory of all but the returns.
_SUB_RAYS_PER_BLOCK = 1 << 18


class LidarReturns(RayRows):
    """Returns of pulses, as rows delimited by `ray_splits`: a point cloud.

    Attributes
    ----------
    ray_splits : ndarray of shape (N + 1,), int64
        Pulse i owns the rows ray_splits[i] to ray_splits[i + 1]; pulses are numbered in the
        C order of their leading shape.
    ranges : ndarray of shape (K,), float64
        Distances from the origins, in scene units, increasing within a pulse.
    positions : ndarray of shape (K, 3), float64
        World space: the points at these ranges on the axes of the pulses.
    intensity : ndarray of shape (K,), float64
        Fraction of the pulse's energy; 1 if a white surface at a right angle returns all of it.
    incidence_angle : ndarray of shape (K,), float64
        Degrees between the ray and the normal of the triangle, 0 to 90.
    return_number, return_count : ndarray of shape (K,), int32
        Number of the return within its pulse, from 1; and number of returns of that pulse.
    prim_id, mesh_id, material_id : ndarray of shape (K,), int32
        The triangle that returned the most energy, its mesh and its material.
    instance_id : ndarray of shape (K,), int32
        The instance that the triangle is in; 0 in a scene without instances.
    status : ndarray of the pulses' leading shape, uint8
        A `RayStatus` for each pulse.
    """

    def __init__(
        self,
        ray_splits: NDArray[np.int64],
        returns: Returns,
        mesh_id: NDArray[np.int32],
        material_id: NDArray[np.int32],
        status: NDArray[np.uint8],
    ) -> None:
        self.ray_splits = ray_splits
        self.ranges, self.positions, self.intensity = returns[:3]
        self.incidence_angle, self.prim_id, self.instance_id = returns[3:]
        self.mesh_id, self.material_id, self.status = mesh_id, material_id, status
        counts = np.diff(ray_splits)
        rows = np.arange(len(self.ranges)) - np.repeat(ray_splits[:-1], counts)
        self.return_number = (rows + 1).astype(np.int32)
        self.return_count = np.repeat(counts, counts).astype(np.int32)

    def __repr__(self) -> str:
        return f"LidarReturns({len(self.ranges):,} returns of {len(self.ray_splits) - 1:,} pulses)"


def lidar_returns(
    tracer: Tracer,
    origins: Any,
    directions: Any,
    *,
    t_min: Any = 0.0,
    t_max: Any = np.inf,
    max_returns: int = 5,
    reflectance: Any = 1.0,
    transmission: Any = 0.0,
    threshold: float = 0.01,
    divergence: float = 0.0,
    sub_rays: int = 1,
    separation: float = 0.0,
    min_range: float = 0.0,
    cutouts: bool = True,
    worlds: Any = None,
    progress: Progress | None = None,
) -> LidarReturns:
    """Emit pulses and compute their returns.

    Parameters
    ----------
    tracer : Tracer
    origins, directions, t_min, t_max
        As in `Tracer.first_hit`: one ray per pulse, its axis. A pulse passes through what is nearer
        than `t_min`, as if that were not there: see `min_range`.
    max_returns : int
        Maximum number of returns to keep per pulse, the nearest ones.
    reflectance : mapping, or array_like of shape () or (M,), real
        Diffuse reflectance of the scene's materials, 0 to 1; one number applies to all. A mapping
        has materials, by name or number, as keys, and leaves the others at 1.
    transmission : mapping, or array_like of shape () or (M,), real
        Fraction of a pulse that passes through a surface, 0 to 1, given in the same way; for
        foliage, the fraction of gaps. A mapping leaves the others at 0.
    threshold : float
        Detection threshold: weaker returns are dropped, and a ray continues while it has at least
        this fraction of its energy.
    divergence : float
        Full angle of the pulse's cone in degrees, at most 90.
    sub_rays : int
        Rays per pulse, spread evenly over its cone, with equal energy. A single ray follows the
        axis.
    separation : float
        Echoes less than this distance behind the first echo of a return belong to that return:
        half the length of a pulse, in scene units.
    min_range : float
        Least range of the sensor, in scene units. A nearer return is dropped, as in a real sensor:
        the pulse does not reach what is behind a surface that is too near and lets nothing through.
    cutouts : bool
        Whether pulses pass where a surface is cut out: where the opacity of its material is below
        its ``alpha_cutoff``, or below a half without one. False makes all of it surface.
    worlds : array_like that broadcasts to S, int, optional
        The world of each pulse, as in `Tracer.first_hit`.
    progress : callable, optional
        Called with (pulses done, pulses).

    Returns
    -------
    LidarReturns
        `LibraryLidarReturns` for rays in arrays of PyTorch, JAX, CuPy or xarray.

    Raises
    ------
    ValueError, TypeError
        As `Tracer.first_hit`, or if another argument is out of range; or if there are cut-outs, and
        the tracer counts.

    Notes
    -----
    The model is simple. Each surface transmits its fraction of the remaining energy straight
    ahead, and returns reflectance * cosine of the angle of incidence of the rest (Lambert's
    law). Both sides of a triangle count, and each crossing of a surface. Intensities are those
    of a receiver that corrects for the distance: divide by its square for the power. There is
    no scattering between surfaces, no noise and no atmosphere.

    The range of a return is the mean range of its echoes, weighted by their energy.

    Examples
    --------
    >>> import raystream as rs
    >>> tracer = rs.Tracer(rs.load("cornell"))
    >>> axis = [278.0, 273.0, -800.0], [0.0, 0.0, 1.0]
    >>> glass = rs.lidar_returns(tracer, *axis, transmission=0.5)
    >>> glass.ranges.round().astype(int).tolist(), glass.return_number.tolist()
    ([1092, 1138, 1359], [1, 2, 3])
    """
    held: Any = tracer.structure.triangles
    check_support("lidar_returns", held)
    batch = tracer.structure.ray_batch(origins, directions, t_min, t_max)
    batch.worlds = tracer._world_ids(worlds, batch.shape)
    scene = tracer.scene
    names = tuple(material.name for material in scene.materials)
    reflectances = group_values(
        "reflectance", reflectance, names, "material", high=1.0, default=1.0
    )
    transmissions = group_values(
        "transmission", transmission, names, "material", high=1.0, default=0.0
    )
    surfaces = Surfaces(
        None if held.kinds else held.corners,
        scene.attributes.material_ids,
        reflectances,
        transmissions,
        _check("threshold", threshold, 0.0, 1.0),
    )
    receiver = Receiver(
        check_least("max_returns", max_returns, 1),
        check_least("sub_rays", sub_rays, 1),
        math.tan(math.radians(_check("divergence", divergence, 0.0, MAX_DIVERGENCE) / 2)),
        _check("separation", separation, 0.0, math.inf),
        _check("min_range", min_range, 0.0, math.inf),
    )
    opacity = cutouts_of(tracer, cutouts)
    scan = Scan(tracer, batch, surfaces, receiver, opacity and opacity.on_hit)
    counts, status = np.zeros(len(batch), np.int64), np.zeros(len(batch), np.uint8)
    parts = [scan.returns(slice(0, 0), counts, status)]  # no pulses: the columns' dtypes
    size = max(1, _SUB_RAYS_PER_BLOCK // receiver.sub_rays)
    for first in range(0, len(batch), size):
        rows = slice(first, min(first + size, len(batch)))
        parts.append(scan.returns(rows, counts, status))
        if progress:
            progress(rows.stop, len(batch))
    returns = Returns(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    mesh_splits = held.mesh_splits
    found = LidarReturns(
        np.concatenate([[0], np.cumsum(counts)]),
        returns,
        (np.searchsorted(mesh_splits, returns.prim_id, side="right") - 1).astype(np.int32),
        held.materials_at(returns.prim_id),
        status.reshape(batch.shape),
    )
    return in_library_of(origins, directions, found, LibraryLidarReturns)


def _check(name: str, value: float, low: float, high: float) -> float:
    if not low <= value <= high:
        raise ValueError(f"{name}: expected a number from {low:g} to {high:g}, got {value}")
    return float(value)
