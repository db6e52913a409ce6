"""Camera: generates camera rays through points of an image."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raystream.scene.lens import disk_points, lens_samples
from raystream.scene.projections import PROJECTIONS, ahead, around, beside

Vector = tuple[float, float, float]

#: Degrees of the default field of view, from the top of the image to its bottom.
FOV = 40.0


def unit_vector(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """Scale a vector to length 1; raises ValueError if it is zero or not finite."""
    vector = np.asarray(values, np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all() or not vector.any():
        raise ValueError(f"{name}: expected three finite numbers, not all zero, got {values!r}")
    vector = vector / np.abs(vector).max()
    return vector / np.linalg.norm(vector)


@dataclass(frozen=True)
class Camera:
    """A camera in a right-handed world; a pinhole by default.

    Parameters that a projection does not use are ignored, so that the projection can be replaced
    alone; but only a perspective camera can have a lens.

    Parameters
    ----------
    eye : Vector
        Position of the pinhole, of the lens's centre, of the centre of the plane from which
        orthographic rays start, or of the sphere's centre; world space.
    look_at : Vector
        The point in the centre of the image.
    up : Vector
        The direction that is up in the image; need not be perpendicular to the view.
    fov : float
        Vertical field of view in degrees, in (0, 180).
    projection : {"perspective", "orthographic", "equirectangular"}
        The volume shown: a pyramid in front of the eye; a box, by parallel rays that see
        nothing behind the eye; or the whole sphere around the eye, 360 degrees of longitude
        across and 180 of latitude down, with the view direction in the centre, where pixels are
        square if the image is twice as wide as high.
    height : float, optional
        Height of an orthographic image, world units, above 0 [default: the height that a
        perspective camera of this `fov` shows at `look_at`].
    aperture : float
        Diameter of the lens of a perspective camera, world units; 0 is a pinhole.
    focus : float, optional
        Distance from the eye to the plane in focus, along the view, world units, above 0
        [default: the distance to `look_at`].

    Raises
    ------
    ValueError
        If a number is not finite or out of range, eye and look_at coincide, up is parallel to
        the view, the projection is unknown, or a projection without a lens has an aperture.

    References
    ----------
    Purcell 2002, section 3.1.1 (the eye ray generator). Cook, Porter and Carpenter,
    "Distributed Ray Tracing", SIGGRAPH 1984 (the lens).
    """

    eye: Vector
    look_at: Vector
    up: Vector = (0.0, 1.0, 0.0)
    fov: float = FOV
    projection: str = "perspective"
    height: float | None = None
    aperture: float = 0.0
    focus: float | None = None

    def __post_init__(self) -> None:
        for name in ("eye", "look_at", "up"):
            vector = tuple(float(c) for c in np.asarray(getattr(self, name)).ravel())
            if len(vector) != 3 or not all(map(math.isfinite, vector)):
                raise ValueError(f"{name}: expected three finite numbers, got {vector}")
            object.__setattr__(self, name, vector)
        if not 0.0 < self.fov < 180.0:
            raise ValueError(f"fov: expected degrees between 0 and 180, got {self.fov}")
        if self.eye == self.look_at:
            raise ValueError("look_at: must differ from eye")
        self.basis()
        if self.projection not in PROJECTIONS:
            known = " or ".join(map(repr, PROJECTIONS))
            raise ValueError(f"projection: expected {known}, got {self.projection!r}")
        for name in ("height", "focus"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _length(name, getattr(self, name)))
        object.__setattr__(self, "aperture", _length("aperture", self.aperture, zero=True))
        if self.aperture > 0.0 and self.projection != "perspective":
            raise ValueError(f"aperture: only a perspective camera has a lens, got {self.aperture}")

    @classmethod
    def framing(
        cls,
        low: ArrayLike,
        high: ArrayLike,
        *,
        up: ArrayLike = (0.0, 1.0, 0.0),
        fov: float = FOV,
        aspect: float = 4.0 / 3.0,
    ) -> Camera:
        """Place a camera so that a box fills the image, seen from the front, right and above.

        Parameters
        ----------
        low, high : array_like of shape (3,)
            Corners of the box, world space.
        up : array_like of shape (3,)
            The world's up; its length does not matter.
        fov : float
            Vertical field of view in degrees.
        aspect : float
            Width of the image divided by its height.
        """
        up = unit_vector("up", up)
        return frame_box(low, high, three_quarter_view(up), up, fov=fov, aspect=aspect)

    @property
    def image_height(self) -> float:
        """Height of an orthographic image, world units: `height` or its default."""
        if self.height is not None:
            return self.height
        return 2.0 * math.tan(math.radians(self.fov) / 2) * math.dist(self.eye, self.look_at)

    @property
    def focus_distance(self) -> float:
        """Distance to the plane in focus, world units: `focus` or its default."""
        return self.focus if self.focus is not None else math.dist(self.eye, self.look_at)

    def basis(self) -> NDArray[np.float64]:
        """Orthonormal basis of the image.

        Returns
        -------
        ndarray of shape (3, 3), float64
            Rows: right, up, and forward (into the image), world space.
        """
        forward = np.subtract(self.look_at, self.eye)
        forward = forward / np.linalg.norm(forward)
        up = np.asarray(self.up, np.float64)
        norm = float(np.linalg.norm(up))
        right = np.cross(forward, up / norm) if norm > 0.0 else np.zeros(3)
        length = float(np.linalg.norm(right))
        if not length > 1e-9:
            raise ValueError("up: must not be zero or parallel to the view direction")
        right /= length
        return np.stack([right, np.cross(right, forward), forward])

    def rays(
        self,
        width: int,
        height: int,
        x: ArrayLike | None = None,
        y: ArrayLike | None = None,
        lens: ArrayLike | None = None,
    ) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """Generate the camera rays through points of the image.

        Parameters
        ----------
        width, height : int
            Size of the image in pixels. Pixels are square, except in equirectangular images.
        x, y : array_like that broadcast to a shape S, float, optional
            Points in pixels: (0, 0) is the upper left corner of the image, and pixel
            (column, row) covers [column, column + 1) x [row, row + 1) [default: every
            pixel's centre, S = (height, width)].
        lens : array_like of shape S + (2,), float, optional
            Samples in [0, 1) of the point where each ray passes through the lens, mapped uniformly
            to its disk, to the right and upward; (0.5, 0.5) is its centre. The leading shape is
            broadcast against `x` and `y`, even if the camera has no lens [default: the centre of
            the lens].

        Returns
        -------
        origins : ndarray of shape S + (3,), float64
            World space. Pinhole, equirectangular, or without `lens`: the eye, broadcast
            (read-only). Orthographic: points of the plane through the eye. With `lens`:
            points of the lens.
        directions : ndarray of shape S + (3,), float32
            Unit length, world space; orthographic: all the same. With `lens`: toward the point
            where the pinhole ray intersects the plane in focus.

        Raises
        ------
        ValueError
            If `lens` is not in [0, 1), or shapes do not broadcast.
        """
        if x is None or y is None:
            x = np.arange(width, dtype=np.float64)[None, :] + 0.5
            y = np.arange(height, dtype=np.float64)[:, None] + 0.5
        across, down = np.asarray(x, np.float64) - width / 2, np.asarray(y, np.float64) - height / 2
        basis, eye = self.basis(), np.asarray(self.eye, np.float64)
        samples = None if lens is None else lens_samples(lens)
        if samples is not None:
            across, down = _broadcast_to_lens(across, down, samples)
        if self.projection == "orthographic":
            scale = self.image_height / height
            origins = eye + beside(across * scale, down * scale, basis)
            directions = np.broadcast_to(basis[2], origins.shape)
            return origins, directions.astype(np.float32, order="C")
        if self.projection == "equirectangular":
            turns = 2.0 * math.pi / width, math.pi / height
            directions = around(across * turns[0], down * turns[1], basis)
            return np.broadcast_to(eye, directions.shape), directions.astype(np.float32)
        scale = 2.0 * math.tan(math.radians(self.fov) / 2) / height
        directions = ahead(across * scale, down * scale, basis)
        origins = np.broadcast_to(eye, directions.shape)
        if samples is not None and self.aperture > 0.0:
            points = 0.5 * self.aperture * disk_points(samples)
            offsets = beside(points[..., 0], -points[..., 1], basis)
            origins = eye + np.broadcast_to(offsets, directions.shape)
            directions = self.focus_distance * directions - offsets
        directions /= np.sqrt(np.einsum("...k,...k->...", directions, directions))[..., None]
        return origins, directions.astype(np.float32)


def front_of(up: NDArray[np.float64]) -> NDArray[np.float64]:
    """The direction from which models are seen from the front, for a unit vector up."""
    return np.array([0.0, 0.0, 1.0]) if abs(up[1]) >= abs(up[2]) else np.array([0.0, -1.0, 0.0])


def three_quarter_view(up: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit vector from a model to the eye of the usual view: in front, to the right and above."""
    front = front_of(up)
    toward_eye = front + 0.55 * np.cross(up, front) + 0.45 * up
    toward_eye /= np.linalg.norm(toward_eye)
    return toward_eye


def frame_box(
    low: ArrayLike,
    high: ArrayLike,
    toward_eye: NDArray[np.float64],
    up: NDArray[np.float64],
    *,
    fov: float = FOV,
    aspect: float = 4.0 / 3.0,
) -> Camera:
    """Place a camera so that a box fills the image.

    Parameters
    ----------
    low, high, fov, aspect
        See `Camera.framing`.
    toward_eye, up : ndarray of shape (3,), float64
        Unit vectors: from the box to the eye, and the world's up, not parallel to it.
    """
    low, high = np.asarray(low, np.float64), np.asarray(high, np.float64)
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    return frame_points(corners, low + (high - low) / 2, toward_eye, up, fov=fov, aspect=aspect)


def frame_points(
    points: NDArray[np.float64],
    center: NDArray[np.float64],
    toward_eye: NDArray[np.float64],
    up: NDArray[np.float64],
    *,
    fov: float = FOV,
    aspect: float = 4.0 / 3.0,
) -> Camera:
    """Place a camera so that points fill the image; it looks at `center`. See `frame_box`."""
    axis_right = np.cross(up, toward_eye)
    axis_right /= np.linalg.norm(axis_right)
    axis_up = np.cross(toward_eye, axis_right)
    tan_up = math.tan(math.radians(fov) / 2)
    tan_right = tan_up * aspect
    # Back off until every point lies inside the frustum.
    distance = 0.0
    for corner in points - center:
        depth = corner @ toward_eye
        distance = max(
            distance,
            depth + abs(corner @ axis_right) / tan_right,
            depth + abs(corner @ axis_up) / tan_up,
        )
    distance = distance * 1.05 if distance > 0.0 else max(1.0, float(np.abs(center).max()))
    return Camera(tuple(center + distance * toward_eye), tuple(center), tuple(up), fov)


def _broadcast_to_lens(
    across: NDArray[np.float64], down: NDArray[np.float64], samples: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    try:
        across, down, _ = np.broadcast_arrays(across, down, samples[..., 0])
    except ValueError:
        raise ValueError(
            f"lens: shape {samples.shape} does not broadcast to x {across.shape} and "
            f"y {down.shape}, with 2 at the end"
        ) from None
    return across, down


def _length(name: str, value: float, *, zero: bool = False) -> float:
    """Check a length: finite, and above 0, or at least 0."""
    try:
        length = float(value)
    except (TypeError, ValueError, OverflowError):
        length = math.nan
    if not (math.isfinite(length) and (length > 0.0 or (zero and length == 0.0))):
        wanted = "of 0 or more" if zero else "above 0"
        raise ValueError(f"{name}: expected a finite length {wanted}, got {value!r}")
    return length
