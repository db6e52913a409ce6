"""The sky, seen by rays that miss: radiance, samples and their density.

It is a constant radiance plus, optionally, a bilinear image by longitude and latitude. Samples of
an image choose a row and then a texel of it, by their light; within a texel they are uniform over
solid angle (Pharr, Jakob and Humphreys, "Physically Based Rendering", 3rd edition, section 14.2.4,
with rows cut at sines of latitudes). A texel's probability includes its neighbours, which
contribute to the bilinear image within it: no direction has light without density.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raystream.core.memory import check_memory
from raystream.jit.constants import BYTES_32, NULL, ONE_U64, TWO_U64, ZERO_U64
from raystream.jit.cpu import device, device_call
from raystream.jit.simd import load
from raystream.rendering.color import LUMINANCE
from raystream.rendering.environment import axes_of, image_light, row_heights, texels_of
from raystream.rendering.shading.discrete_distribution import double, sample_discrete
from raystream.rendering.shading.keep_alive import AddressRow
from raystream.rendering.shading.textures import address_of
from raystream.scene.lights import EnvironmentLight
from raystream.scene.scene import Scene

# Bytes of a float32, of a float64, of a texel.
_LONG = np.uint64(8)
_TEXEL = np.uint64(12)

# Indices in `Sky.image`.
_HEIGHT, _TEXELS, _ROW_ENDS, _COLUMN_ENDS, _TINT, _RIGHT, _UP, _MIDDLE = map(
    np.uint64, (1, 2, 3, 4, 5, 8, 11, 14)
)

#: Those of them that are addresses.
_ADDRESSES = (2, 3, 4)

#: Weight of neighbours in a texel's probability, along each axis. Around a single bright texel the
#: root mean square of the bilinear image over texels is 0.27 : 1 : 0.27, so 0.25 is near optimal.
_BESIDE = 0.25

#: Memory per texel for preparing sampling.
_BYTES_PER_TEXEL = 32

Vector = tuple[float, float, float]


class Sky(NamedTuple):
    """The sky of a scene, made by `sky_of` with the arrays to keep alive.

    Attributes
    ----------
    color : tuple of three float
        Constant radiance, linear RGB.
    image : uint64
        0, or the address of 17 numbers of 8 bytes: width and height, uint64; addresses of
        texels, shape (H, W, 3), float32, of cumulative sums of shares of rows, (H,), float64, and
        of texels within each row, (H, W), float64 (0 where the sky is not sampled); a factor on
        texels, three float64; directions to the right, up and to the image's middle, unit
        vectors of three float64.
    """

    color: Vector
    image: np.uint64


def sky_of(
    color: ArrayLike, light: EnvironmentLight | None, is_sampled: bool = True
) -> tuple[Sky, float, object]:
    """Make a sky; return its mean luminance and the arrays to keep alive, too.

    Parameters
    ----------
    color : array_like of shape (3,)
        Constant radiance.
    light : EnvironmentLight or None
        A light with an image, which is added.
    is_sampled : bool
        Whether it can be sampled; if not, the mean luminance is 0.

    Raises
    ------
    FileFormatError, ImportError
        See `environment.texels_of`.
    MemoryError
        If the image's cumulative sums do not fit into memory.
    """
    red, green, blue = (float(value) for value in np.asarray(color))
    mean = float(np.abs([red, green, blue]) @ LUMINANCE) if is_sampled else 0.0
    if light is None:
        return Sky((red, green, blue), np.uint64(0)), mean, None
    texels = texels_of(light)
    height, width = texels.shape[:2]
    row_ends = column_ends = None
    if is_sampled:
        row_ends, column_ends, mean = _shares(np.abs(color), np.array(light.radiance), texels)
    numbers = np.empty(17)
    numbers[5:] = np.concatenate([light.radiance, axes_of(light).ravel()])
    numbers.view(np.uint64)[:5] = [
        width,
        height,
        address_of(texels),
        address_of(row_ends),
        address_of(column_ends),
    ]
    kept = AddressRow(numbers, _ADDRESSES), texels, row_ends, column_ends
    return Sky((red, green, blue), address_of(numbers)), mean, kept


def background_of(scene: Scene) -> tuple[Sky, object]:
    """The sky of modes with punctual lights, and the arrays to keep alive.

    The background, and the image of an environment light; lights without an image are not seen.
    """
    sky, _, kept = sky_of(scene.background, image_light(scene.lights), is_sampled=False)
    return sky, kept


def _shares(
    color: NDArray[np.float64], tint: NDArray[np.float64], texels: NDArray[np.float32]
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Cumulative probabilities of rows, and of texels in rows; mean luminance."""
    height, width = texels.shape[:2]
    check_memory(width * height * _BYTES_PER_TEXEL, f"sampling an image of {width}x{height} would")
    light = np.full((height, width), float(color @ LUMINANCE))
    for k in range(3):
        factor = abs(float(tint[k])) * LUMINANCE[k]
        light += np.multiply(texels[:, :, k], factor, dtype=np.float64)
    mean = float(row_heights(height) @ light.mean(axis=1)) / 2.0
    for axis in (0, 1):  # rows end at the poles, columns wrap around
        before, after = np.roll(light, 1, axis), np.roll(light, -1, axis)
        if axis == 0:
            before[0], after[-1] = light[0], light[-1]
        before += after
        before *= _BESIDE
        light += before
        del before, after
    ends = np.cumsum(light, axis=1, out=light)
    rows = ends[:, -1] * row_heights(height)
    np.divide(ends, ends[:, -1:], out=ends, where=ends[:, -1:] > 0.0)
    row_ends = np.cumsum(rows)
    if row_ends[-1] > 0.0:
        row_ends /= row_ends[-1]
    return row_ends, ends, mean


@device
def _long(at, k):
    return load(np.uint64, at + k * _LONG)


@device
def _along(image, axis, x, y, z):
    """The component of a vector along one of the image's axes."""
    return (
        double(image, axis) * x
        + double(image, axis + ONE_U64) * y
        + double(image, axis + TWO_U64) * z
    )


@device
def _place(image, x, y, z):
    """Column and row of a direction of any length, as fractions from the upper left corner."""
    width, height = np.float64(_long(image, ZERO_U64)), np.float64(_long(image, _HEIGHT))
    right, up = _along(image, _RIGHT, x, y, z), _along(image, _UP, x, y, z)
    middle = _along(image, _MIDDLE, x, y, z)
    column = (math.atan2(right, middle) / (2.0 * math.pi) + 0.5) * width
    row = math.atan2(math.sqrt(right * right + middle * middle), up) / math.pi * height
    return column, row


@device
def _texel(image, row, column):
    at = _long(image, _TEXELS) + (row * _long(image, ZERO_U64) + column) * _TEXEL
    return (
        np.float64(load(np.float32, at)),
        np.float64(load(np.float32, at + BYTES_32)),
        np.float64(load(np.float32, at + BYTES_32 + BYTES_32)),
    )


@device
def _mixed(a, b, share):
    return (
        a[0] + (b[0] - a[0]) * share,
        a[1] + (b[1] - a[1]) * share,
        a[2] + (b[2] - a[2]) * share,
    )


@device_call
def image_radiance(sky, x, y, z):
    """The sky's radiance where it has an image."""
    image = sky.image
    width, height = np.int64(_long(image, ZERO_U64)), np.int64(_long(image, _HEIGHT))
    column, row = _place(image, x, y, z)
    column, row = column - 0.5, row - 0.5
    first, top = np.int64(math.floor(column)), np.int64(math.floor(row))
    across, down = column - first, row - top
    # Rows end at the poles, columns wrap around. Invalid directions get some texel.
    first = min(max(first, -1), width - 1)
    left = np.uint64(first if first >= 0 else width - 1)
    right = np.uint64(first + 1 if first + 1 < width else 0)
    upper = np.uint64(min(max(top, 0), height - 1))
    lower = np.uint64(min(max(top + 1, 0), height - 1))
    above = _mixed(_texel(image, upper, left), _texel(image, upper, right), across)
    below = _mixed(_texel(image, lower, left), _texel(image, lower, right), across)
    red, green, blue = _mixed(above, below, down)
    return (
        sky.color[0] + double(image, _TINT) * red,
        sky.color[1] + double(image, _TINT + ONE_U64) * green,
        sky.color[2] + double(image, _TINT + TWO_U64) * blue,
    )


@device
def _slice(row, height):
    """Height of a row's slice of the unit sphere."""
    half = math.pi / 2.0 / np.float64(height)
    return 2.0 * math.sin(half) * math.sin(half * (2.0 * np.float64(row) + 1.0))


@device_call
def relative_pdf(sky, x, y, z):
    """Density over solid angle of `sample_image` at a direction of any length, times 4 pi."""
    image = sky.image
    width, height = _long(image, ZERO_U64), _long(image, _HEIGHT)
    across, down = _place(image, x, y, z)
    column = np.uint64(min(max(across, 0.0), np.float64(width - ONE_U64)))
    row = np.uint64(min(max(down, 0.0), np.float64(height - ONE_U64)))
    share = _share(_long(image, _ROW_ENDS), row)
    share *= _share(_long(image, _COLUMN_ENDS) + row * width * _LONG, column)
    return share * 2.0 * np.float64(width) / _slice(row, height)


@device
def _share(ends, k):
    return double(ends, k) - (double(ends, k - ONE_U64) if k != ZERO_U64 else 0.0)


@device_call
def sample_image(sky, u, v):
    """Sample a direction of a sky that has an image, by its light.

    Parameters
    ----------
    sky : Sky
        With an image, and sampled.
    u, v : float64
        Random numbers in [0, 1).

    Returns
    -------
    toward : tuple of three float64
        Unit vector, world space.
    density : float64
        Over solid angle, times 4 pi: 1 is uniform.
    """
    image = sky.image
    width, height = _long(image, ZERO_U64), _long(image, _HEIGHT)
    row, row_share, down = sample_discrete(_long(image, _ROW_ENDS), height, v)
    ends = _long(image, _COLUMN_ENDS) + row * width * _LONG
    column, share, across = sample_discrete(ends, width, u)
    thickness = _slice(row, height)
    # From the nearer pole, to avoid cancellation next to it.
    is_upper = row + row < height
    first = np.float64(row if is_upper else height - ONE_U64 - row)
    within = down if is_upper else 1.0 - down
    below = 2.0 * math.sin(math.pi / 2.0 * first / np.float64(height)) ** 2 + within * thickness
    radius = math.sqrt(below * (2.0 - below))
    high = 1.0 - below if is_upper else below - 1.0
    angle = 2.0 * math.pi * ((np.float64(column) + across) / np.float64(width) - 0.5)
    right, middle = radius * math.sin(angle), radius * math.cos(angle)
    toward = (
        _combined(image, ZERO_U64, right, high, middle),
        _combined(image, ONE_U64, right, high, middle),
        _combined(image, TWO_U64, right, high, middle),
    )
    return toward, row_share * share * 2.0 * np.float64(width) / thickness


@device
def _combined(image, k, right, up, middle):
    """Coordinate k of a vector, from its components along the image's axes."""
    return (
        double(image, _RIGHT + k) * right
        + double(image, _UP + k) * up
        + double(image, _MIDDLE + k) * middle
    )


@device
def sky_radiance(lights, x, y, z):
    """Radiance of the sky in a direction.

    Parameters
    ----------
    lights : LightTables or PunctualLights
    x, y, z : float64
        Of any length above 0.

    Returns
    -------
    tuple of three float64
    """
    if lights.sky.image == NULL:
        return lights.sky.color
    return image_radiance(lights.sky, x, y, z)


@device
def sky_pdf(lights, x, y, z):
    """Density over solid angle of `sample_light` for the sky in a direction.

    Parameters
    ----------
    lights : LightTables
    x, y, z : float64
        Of any length above 0.
    """
    if lights.sky.image == NULL:
        return lights.sky_density
    return lights.sky_density * relative_pdf(lights.sky, x, y, z)
