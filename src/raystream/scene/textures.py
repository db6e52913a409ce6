"""Procedural textures: functions evaluated once at each texel's centre."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raystream.scene.texture import MAX_TEXTURE_PIXELS, Texture, Wraps

__all__ = ["baked", "checker", "noise"]

Encoding = Literal["srgb", "plain"]

_SMALL = 0.0031308  # below, sRGB is a line


def baked(
    function: Callable[[NDArray[np.float64], NDArray[np.float64]], ArrayLike],
    size: tuple[int, int] = (512, 512),
    *,
    encoding: Encoding = "srgb",
    wrap: Wraps = "repeat",
    name: str = "",
) -> Texture:
    """Make a texture from a function of texture coordinates.

    Parameters
    ----------
    function : callable
        ``function(u, v)``, called once with arrays of shape (H, W), float64: the texels'
        centres in [0, 1], v upward. It returns numbers in [0, 1], of shape (H, W) for greys or
        (H, W, 3) for colours, or an array with the same number of axes that broadcasts to one of
        these; a single number is a uniform grey. Values are clipped to [0, 1].
    size : tuple of two int
        Width and height in texels.
    encoding : {"srgb", "plain"}
        Encoding of numbers as bytes: "srgb" for linear colours, "plain" for other data, such as
        heights of bump maps, normals or roughness.
    wrap, name
        See `Texture`.

    Returns
    -------
    Texture

    Raises
    ------
    ValueError
        If the size is not positive or exceeds `MAX_TEXTURE_PIXELS`, or the result has the wrong
        shape or is not finite.

    Examples
    --------
    >>> import numpy as np
    >>> import raystream as rs
    >>> rings = rs.textures.baked(lambda u, v: np.sin(40 * np.hypot(u - 0.5, v - 0.5)) ** 2)
    >>> target = rs.Material(textures={"diffuse": rings})
    """
    width, height = (int(n) for n in size)
    if width < 1 or height < 1 or width * height > MAX_TEXTURE_PIXELS:
        raise ValueError(f"size: expected two positive numbers of texels, got {size!r}")
    if encoding not in ("srgb", "plain"):
        raise ValueError(f"encoding: expected 'srgb' or 'plain', got {encoding!r}")
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, 1.0 - (np.arange(height) + 0.5) / height)
    values = np.asarray(function(u, v), np.float64)
    shape = (height, width) if values.ndim <= 2 else (height, width, 3)
    try:
        values = np.broadcast_to(values, shape)
    except ValueError:
        raise ValueError(
            f"function: expected numbers of shape {(height, width)} or {(height, width, 3)}, "
            f"got {values.shape}"
        ) from None
    if not np.isfinite(values).all():
        raise ValueError("function: expected finite numbers; some are NaN or infinite")
    pixels = _bytes_of(values, encoding).reshape(height, width, -1)
    return Texture(pixels, name=name or getattr(function, "__name__", ""), wrap=wrap)


def checker(
    one: ArrayLike = (0.8, 0.8, 0.8),
    other: ArrayLike = (0.2, 0.2, 0.2),
    count: tuple[int, int] = (8, 8),
    *,
    texels: int = 64,
) -> Texture:
    """Make a checkerboard of two colours.

    Parameters
    ----------
    one, other : array_like of three float
        Linear RGB in [0, 1]; `one` is at the lower left, where u and v are 0.
    count : tuple of two int
        Squares across [0, 1] along u and v; even numbers if the texture is to repeat.
    texels : int
        Texels per side of a square. Edges are one texel wide.

    Returns
    -------
    Texture

    Raises
    ------
    ValueError
        If a number or a colour is out of range.
    """
    across, up = (int(n) for n in count)
    if across < 1 or up < 1 or texels < 1:
        raise ValueError(f"count, texels: expected positive numbers, got {count!r}, {texels!r}")
    colors = np.stack([_color("one", one), _color("other", other)])

    def squares(u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
        place = np.floor(u * across) + np.floor(v * up)
        return colors[(place % 2.0).astype(np.intp)]

    return baked(squares, (across * texels, up * texels), name="checker")


def noise(
    low: ArrayLike = (0.0, 0.0, 0.0),
    high: ArrayLike = (1.0, 1.0, 1.0),
    frequency: int = 8,
    *,
    octaves: int = 4,
    seed: int = 0,
    size: int = 512,
    encoding: Encoding = "srgb",
) -> Texture:
    """Make fractal gradient noise that tiles seamlessly.

    Parameters
    ----------
    low, high : array_like of three float
        Colours in [0, 1] that are mixed; the noise is roughly symmetric around the middle.
    frequency : int
        Cells per side of the coarsest octave.
    octaves : int
        Octaves; each has twice the frequency of the previous one, and half its amplitude.
    seed : int
        Seed of the gradients.
    size : int
        Texels per side; the finest cells need at least four.
    encoding : {"srgb", "plain"}
        See `baked`; "plain" for bump maps.

    Returns
    -------
    Texture

    Raises
    ------
    ValueError
        If a number or a colour is out of range.

    References
    ----------
    Perlin, "Improving Noise", 2002: gradients at cell corners and a blend of degree five. Here the
    gradients are random, depending on the seed.
    """
    if frequency < 1 or octaves < 1 or size < 1 or frequency << (octaves - 1) > size:
        raise ValueError(
            "frequency, octaves, size: expected positive numbers, and at least one texel for "
            f"frequency * 2**(octaves - 1) cells; got {frequency}, {octaves}, {size}"
        )
    first, last = _color("low", low), _color("high", high)
    numbers = np.random.default_rng(seed)

    def spots(u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
        total = np.zeros_like(u)
        for octave in range(octaves):
            total += _gradient_noise(u, v, frequency << octave, numbers) * 0.5**octave
        # The amplitude of one octave is at most sqrt(1/2).
        share = np.clip(0.5 + total / (2.0 * np.sqrt(0.5)), 0.0, 1.0)
        return first + share[:, :, None] * (last - first)

    return baked(spots, (size, size), encoding=encoding, name="noise")


def _gradient_noise(
    u: NDArray[np.float64], v: NDArray[np.float64], count: int, numbers: np.random.Generator
) -> NDArray[np.float64]:
    """Return noise of `count` cells per side, 0 at their corners."""
    angles = 2.0 * np.pi * numbers.random((count, count))
    x, y = u * count, v * count
    column, row = np.floor(x).astype(np.intp), np.floor(y).astype(np.intp)
    x, y = x - column, y - row

    def slope(right: int, up: int) -> NDArray[Any]:
        angle = angles[(row + up) % count, (column + right) % count]
        return np.cos(angle) * (x - right) + np.sin(angle) * (y - up)

    across, upward = (s * s * s * (s * (6.0 * s - 15.0) + 10.0) for s in (x, y))
    lower = slope(0, 0) * (1.0 - across) + slope(1, 0) * across
    upper = slope(0, 1) * (1.0 - across) + slope(1, 1) * across
    return lower * (1.0 - upward) + upper * upward


def _color(name: str, color: ArrayLike) -> NDArray[np.float64]:
    values = np.asarray(color, np.float64)
    if values.shape != (3,) or not ((values >= 0.0) & (values <= 1.0)).all():
        raise ValueError(f"{name}: expected three numbers from 0 to 1, got {color!r}")
    return values


def _bytes_of(values: NDArray[np.float64], encoding: Encoding) -> NDArray[np.uint8]:
    values = np.clip(values, 0.0, 1.0)
    if encoding == "srgb":
        bent = 1.055 * np.maximum(values, _SMALL) ** (1.0 / 2.4) - 0.055
        values = np.where(values <= _SMALL, 12.92 * values, bent)
    return np.rint(255.0 * values).astype(np.uint8)
