"""Spheres: centres and radii in float64, and points on them by two numbers."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.masks import ALL_BITS, as_mask
from raystream.core.rays import as_integers, as_real_array
from raystream.core.triangles import MAX_COORDINATE


@dataclass(frozen=True)
class Spheres:
    """Spheres in world space.

    Attributes
    ----------
    centers : ndarray of shape (N, 3), float64
    radii : ndarray of shape (N,), float64
    material_ids : ndarray of shape (N,), int32
    masks : ndarray of shape (N,), uint32
    """

    centers: NDArray[np.float64]
    radii: NDArray[np.float64]
    material_ids: NDArray[np.int32]
    masks: NDArray[np.uint32]

    @classmethod
    def of(cls, centers: Any, radii: Any, material_ids: Any = 0, mask: int = ALL_BITS) -> Spheres:
        """Check the arguments of `Scene.spheres`, and copy them."""
        places = as_real_array("centers", centers).astype(np.float64)
        if places.size == 0:
            places = places.reshape(0, 3)
        if places.ndim != 2 or places.shape[1] != 3:
            raise ValueError(f"centers: expected shape (N, 3), got {places.shape}")
        count = len(places)
        sizes = _spread("radii", as_real_array("radii", radii), count).astype(np.float64)
        with np.errstate(invalid="ignore"):
            is_sound = (np.abs(places) <= MAX_COORDINATE).all(axis=1)
        if not is_sound.all():
            bad = int(np.argmin(is_sound))
            raise ValueError(
                f"centers: expected finite coordinates, at most 2**200; row {bad} is "
                f"{places[bad].tolist()}; leave out all {count - int(is_sound.sum()):,} such rows"
            )
        with np.errstate(invalid="ignore"):
            is_sound = (sizes > 0.0) & (sizes <= MAX_COORDINATE)
        if not is_sound.all():
            bad = int(np.argmin(is_sound))
            raise ValueError(
                f"radii: expected finite numbers above 0, got {sizes[bad]} for sphere {bad}"
            )
        ids = as_integers("material_ids", material_ids)
        if ids.size and not (ids.min() >= 0 and ids.max() < 2**31):
            raise ValueError("material_ids: expected numbers of materials, from 0")
        ids = _spread("material_ids", ids, count).astype(np.int32)
        masks = np.broadcast_to(np.uint32(as_mask("mask", mask)), (count,))
        return cls(places, sizes, ids, masks)

    @classmethod
    def joined(cls, parts: Iterable[Spheres]) -> Spheres:
        """The spheres of several parts, one after another."""
        held = [vars(one) for one in (NO_SPHERES, *parts)]
        return cls(**{name: np.concatenate([one[name] for one in held]) for name in held[0]})

    def are_same(self, other: Spheres) -> bool:
        """Whether others have the same numbers."""
        others = vars(other)
        return all(np.array_equal(own, others[name]) for name, own in vars(self).items())

    def __len__(self) -> int:
        return len(self.radii)

    @property
    def bounds(self) -> NDArray[np.float64]:
        """The box around all spheres, shape (2, 3); zeros without any."""
        if not len(self.radii):
            return np.zeros((2, 3))
        low = (self.centers - self.radii[:, None]).min(axis=0)
        return np.array([low, (self.centers + self.radii[:, None]).max(axis=0)])


def _spread(name: str, values: NDArray[Any], count: int) -> NDArray[Any]:
    if values.shape not in ((), (count,)):
        raise ValueError(f"{name}: expected one number or shape ({count},), got {values.shape}")
    return np.broadcast_to(values, (count,))


#: None at all.
NO_SPHERES = Spheres.of(np.zeros((0, 3)), 1.0)


def _unfolded(
    u: NDArray[Any], v: NDArray[Any]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """The points (u, v) of the octahedron; also x and y of the square, and which are below."""
    x = 2.0 * np.asarray(u, np.float64) - 1.0
    y = 2.0 * np.asarray(v, np.float64) - 1.0
    z = 1.0 - np.abs(x) - np.abs(y)
    is_below = z < 0.0
    folded_x = np.where(is_below, (1.0 - np.abs(y)) * np.copysign(1.0, x), x)
    folded_y = np.where(is_below, (1.0 - np.abs(x)) * np.copysign(1.0, y), y)
    points = np.stack([folded_x, folded_y, z], axis=-1)
    return points, np.stack([x, y]), is_below


def directions_at(u: NDArray[Any], v: NDArray[Any]) -> NDArray[np.float64]:
    """Unit vectors, shape (..., 3), from centres to the points (u, v) of spheres.

    The octahedron |x| + |y| + |z| = 1 is folded flat: its upper half is the square's inner
    diamond, and its lower half the four corners [1]_.

    References
    ----------
    .. [1] Cigolle, Donow, Evangelakos, Mara, McGuire and Meyer, "A Survey of Efficient
       Representations for Independent Unit Vectors", Journal of Computer Graphics Techniques
       3(2), 2014.
    """
    points, _, _ = _unfolded(u, v)
    return points / np.linalg.norm(points, axis=-1, keepdims=True)


def slopes_at(u: NDArray[Any], v: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The derivatives of `directions_at` by u and v, shape (..., 3) each; one-sided at folds."""
    points, (x, y), is_below = _unfolded(u, v)
    length = np.linalg.norm(points, axis=-1, keepdims=True)
    normals = points / length
    sign_x, sign_y = np.copysign(1.0, x), np.copysign(1.0, y)
    own, other = np.where(is_below, 0.0, 1.0), np.where(is_below, -sign_x * sign_y, 0.0)
    slopes = []
    for along in ([own, other, -sign_x], [other, own, -sign_y]):
        by = 2.0 * np.stack(along, axis=-1)  # the square is two wide
        radial = (normals * by).sum(axis=-1, keepdims=True)
        slopes.append((by - radial * normals) / length)
    return slopes[0], slopes[1]


def numbers_toward(directions: NDArray[np.float64]) -> tuple[NDArray[Any], NDArray[Any]]:
    """The u and v of points in these directions, shape (..., 3), from spheres' centres."""
    with np.errstate(invalid="ignore", divide="ignore"):
        folded = directions / np.abs(directions).sum(axis=-1, keepdims=True)
    x, y, z = np.moveaxis(np.nan_to_num(folded), -1, 0)
    outer_x = (1.0 - np.abs(y)) * np.copysign(1.0, x)
    outer_y = (1.0 - np.abs(x)) * np.copysign(1.0, y)
    return 0.5 + 0.5 * np.where(z < 0.0, outer_x, x), 0.5 + 0.5 * np.where(z < 0.0, outer_y, y)
