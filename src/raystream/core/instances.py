"""Instances: objects placed in a scene by affine transforms, any number of times."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.masks import as_masks
from raystream.core.rays import as_integers, as_real_array

#: Beyond this condition number a transform counts as singular.
MAX_CONDITION = 1e9

#: The adjugate loses digits where the determinant of a scaled matrix is below this.
_SMALL_DETERMINANT = 1e-2

#: Worlds take memory each, even if they are empty.
MAX_WORLDS = 1 << 24

#: Numbers of a transform beyond this would leave float64 in products.
MAX_NUMBER = 2.0**200


class Instances:
    """The instances of a scene: which object each one is, and where.

    Immutable. Objects are numbered as they were given, and instances too.

    Parameters
    ----------
    object_ids : array_like of shape (K,), int
        The object of each instance.
    transforms : array_like of shape (K, 3, 4), real
        Object to world space: ``world = transforms[k, :, :3] @ point + transforms[k, :, 3]``.
        Mirroring, shear and scales that differ by axis are allowed.
    worlds : array_like of shape (K,), int, optional
        The world of each instance, from 0; -1 for one that is in all worlds.
    names : sequence of str, optional
        Of each instance.
    masks : array_like of shape (K,), int, optional
        The mask of each instance, unsigned, 32 bits; 0 for those of its meshes.

    Attributes
    ----------
    object_ids : ndarray of shape (K,), int32
    worlds : ndarray of shape (K,), int32, or None
    world_count : int
        0 without worlds.
    names : tuple of str, or None
    masks : ndarray of shape (K,), uint32, or None
    transforms, inverses : ndarray of shape (K, 3, 4), float64
        Object to world space, and world to object space.
    conditions : ndarray of shape (K,), float64
        Condition numbers of the transforms: how much they amplify rounding errors, at least 1.

    Raises
    ------
    ValueError
        If a shape is wrong, a number is not finite or beyond 2**200, or a transform is singular.
    TypeError
        If the numbers are not real, or the ids are not integers.
    """

    __slots__ = (
        "conditions",
        "inverses",
        "masks",
        "names",
        "object_ids",
        "transforms",
        "world_count",
        "worlds",
    )

    object_ids: NDArray[np.int32]
    transforms: NDArray[np.float64]
    inverses: NDArray[np.float64]
    conditions: NDArray[np.float64]
    worlds: NDArray[np.int32] | None
    world_count: int
    names: tuple[str, ...] | None
    masks: NDArray[np.uint32] | None

    def __init__(
        self,
        object_ids: Any,
        transforms: Any,
        worlds: Any = None,
        names: Sequence[str] | None = None,
        masks: Any = None,
    ) -> None:
        matrices = as_real_array("transforms", transforms).astype(np.float64)
        if matrices.size == 0:
            matrices = matrices.reshape(-1, 3, 4)
        if matrices.shape[1:] == (4, 4):
            raise ValueError(
                "transforms: expected shape (K, 3, 4); for 4 x 4 matrices, give matrices[:, :3]"
            )
        if matrices.ndim != 3 or matrices.shape[1:] != (3, 4):
            raise ValueError(f"transforms: expected shape (K, 3, 4), got {matrices.shape}")
        with np.errstate(invalid="ignore"):
            is_sound = np.abs(matrices) <= MAX_NUMBER
        if not is_sound.all():
            bad = int(np.argmin(is_sound.all(axis=(1, 2))))
            raise ValueError(f"transforms: transform {bad} is not finite, or beyond 2**200")
        self.object_ids = _per_instance("object_ids", object_ids, len(matrices))
        self.worlds, self.world_count = None, 0
        if worlds is not None:
            self.worlds = _per_instance("worlds", worlds, len(matrices))
            if self.worlds.min(initial=0) < -1:
                raise ValueError(f"worlds: expected -1 or more, got {self.worlds.min()}")
            self.world_count = int(self.worlds.max(initial=-1)) + 1
            if self.world_count > MAX_WORLDS:
                raise ValueError(f"worlds: expected numbers less than {MAX_WORLDS:,}")
            self.worlds.flags.writeable = False
        self.names = None if names is None else tuple(names)
        if self.names is not None and len(self.names) != len(matrices):
            raise ValueError(
                f"names: expected {len(matrices):,}, one per transform, got {len(self.names):,}"
            )
        self.masks = None if masks is None else np.array(as_masks("masks", masks))
        if self.masks is not None and self.masks.shape != (len(matrices),):
            raise ValueError(
                f"masks: expected {len(matrices):,}, one per transform, got {self.masks.shape}"
            )
        self.transforms = matrices
        self.inverses, self.conditions = inverse_transforms(matrices)
        for array in (self.object_ids, self.transforms, self.inverses, self.conditions):
            array.flags.writeable = False

    @property
    def sides(self) -> NDArray[np.float64]:
        """Shape (K,): -1 for instances that are mirrored, else 1."""
        linear = self.transforms[:, :, :3]
        largest = np.abs(linear).max(axis=(1, 2), keepdims=True, initial=0.0)
        return np.asarray(np.sign(np.linalg.det(linear / largest)), np.float64)

    def in_world(self, world: int) -> NDArray[np.intp]:
        """The instances that are in a world, or in all, increasing.

        Raises
        ------
        ValueError
            If there are no worlds, or not this one.
        """
        if self.worlds is None or not -1 <= world < self.world_count:
            known = f"-1 to {self.world_count - 1:,}" if self.world_count else "a scene with worlds"
            raise ValueError(f"world: expected {known}, got {world}")
        return np.flatnonzero((self.worlds == world) | (self.worlds < 0))

    def picked(self, rows: NDArray[np.intp]) -> Instances:
        """Some of the instances, in no worlds."""
        names = None if self.names is None else [self.names[k] for k in rows]
        masks = None if self.masks is None else self.masks[rows]
        return Instances(self.object_ids[rows], self.transforms[rows], None, names, masks)

    def moved(self, transforms: Any) -> Instances:
        """The same objects, elsewhere.

        Raises
        ------
        ValueError, TypeError
            If the number of transforms differs, and as `Instances`.
        """
        moved = as_real_array("transforms", transforms)
        moved = moved[None] if moved.shape == (3, 4) else moved
        if moved.ndim != 3 or len(moved) != len(self):
            raise ValueError(
                f"transforms: expected shape ({len(self)}, 3, 4), one for each instance as before, "
                f"got {moved.shape}"
            )
        return Instances(self.object_ids, moved, self.worlds, self.names, self.masks)

    def __len__(self) -> int:
        return len(self.object_ids)

    def __reduce__(self) -> tuple[Any, ...]:
        arguments = self.object_ids, self.transforms, self.worlds, self.names, self.masks
        return Instances, arguments

    def __repr__(self) -> str:
        return f"Instances({len(self):,} of {len(np.unique(self.object_ids)):,} objects)"


def _per_instance(name: str, values: Any, count: int) -> NDArray[np.int32]:
    """One integer for each instance."""
    array = as_integers(name, values)
    if array.shape != (count,):
        raise ValueError(
            f"{name}: expected one for each of {count:,} transforms, got shape {array.shape}"
        )
    if array.size and not (array.min() >= -(2**31) and array.max() < 2**31):
        raise ValueError(f"{name}: expected 32-bit integers, got {array.min()} to {array.max()}")
    return np.array(array, np.int32)


def inverse_transforms(
    transforms: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Invert affine transforms of shape (K, 3, 4); returns their condition numbers, too.

    By the adjugate of each matrix, scaled so that its largest number is in [1, 2): nothing
    overflows, and scaling is exact. `numpy.linalg.inv`, by elimination, takes several times as
    long; it is right to within the condition number where the determinant is small.

    Raises
    ------
    ValueError
        If one is singular or nearly so: beyond a condition number of `MAX_CONDITION`; or its
        inverse has numbers beyond 2**200.
    """
    # By columns of the table: along short axes NumPy takes ten times as long.
    table = np.ascontiguousarray(transforms.reshape(-1, 12).T).reshape(3, 4, -1)
    linear, shift = table[:, :3], table[:, 3]
    largest = np.abs(linear.reshape(9, -1)).max(axis=0, initial=0.0)
    exponents = np.frexp(largest)[1] - 1
    scaled = np.ldexp(linear, -exponents)
    a, b, c = scaled
    inverses = np.empty_like(table)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        columns = _cross(b, c), _cross(c, a), _cross(a, b)
        determinant = _dot(a, columns[0])
        for k, column in enumerate(columns):
            inverses[:, k] = column / determinant
        for k in np.flatnonzero(np.abs(determinant) < _SMALL_DETERMINANT).tolist():
            inverses[:, :3, k] = _inverse(scaled[:, :, k])
        condition = _norm(scaled) * _norm(inverses[:, :3])
        inverses[:, :3] = np.ldexp(inverses[:, :3], -exponents)
        for row in inverses:
            row[3] = -_dot(row[:3], shift)
        is_sound = np.abs(inverses.reshape(12, -1)).max(axis=0, initial=0.0) <= MAX_NUMBER
        is_sound &= condition <= MAX_CONDITION
    if not is_sound.all():
        bad = int(np.argmin(is_sound))
        raise ValueError(
            f"transforms: transform {bad} is singular or nearly so: it flattens its object; leave "
            "the instance out, or make it thicker than 1e-9 of its width"
        )
    return np.ascontiguousarray(inverses.reshape(12, -1).T).reshape(-1, 3, 4), condition


def moved(matrices: NDArray[np.float64], points: NDArray[Any]) -> NDArray[np.float64]:
    """Points of shape (N, 3), each moved by its transform of shape (3, 4)."""
    found: NDArray[np.float64] = np.einsum("kij,kj->ki", matrices[:, :, :3], points)
    return found + matrices[:, :, 3]


def _inverse(matrix: NDArray[np.float64]) -> Any:
    try:
        return np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        return np.full((3, 3), np.nan)


def _norm(table: NDArray[np.float64]) -> NDArray[np.float64]:
    """Largest sum of a row's absolute numbers, of matrices of shape (3, 3, K)."""
    return np.abs(table).sum(axis=1).max(axis=0)


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


def _dot(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
