"""Checks of rays and vertices in arrays of any library: NumPy's, and those with its attributes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any


def checked_rays(
    read: Callable[[str, Any], Any],
    broadcast: Callable[..., Sequence[int]],
    origins: Any,
    directions: Any,
    t_min: Any,
    t_max: Any,
) -> tuple[Any, Any, Any, Any]:
    """Rays and their limits as arrays of a library.

    Parameters
    ----------
    read : callable
        Makes an array of real numbers from a name, for errors, and values.
    broadcast : callable
        The library's ``broadcast_shapes``.
    origins, directions : array_like of shape S + (3,)
        They broadcast.
    t_min, t_max : array_like that broadcasts to S

    Raises
    ------
    ValueError
        If shapes disagree.
    """
    vectors = read("origins", origins), read("directions", directions)
    for name, one in zip(("origins", "directions"), vectors, strict=True):
        if one.ndim == 0 or one.shape[-1] != 3:
            raise ValueError(f"{name}: expected shape (..., 3), got {tuple(one.shape)}")
    shape = leading_shape(broadcast, *vectors)
    limits = read("t_min", t_min), read("t_max", t_max)
    for name, one in zip(("t_min", "t_max"), limits, strict=True):
        lengths = zip(reversed(one.shape), reversed(shape), strict=False)
        if one.ndim > len(shape) or any(a not in (1, b) for a, b in lengths):
            raise ValueError(
                f"{name}: shape {tuple(one.shape)} does not broadcast to the rays' shape "
                f"{tuple(shape)}"
            )
    return (*vectors, *limits)


def leading_shape(
    broadcast: Callable[..., Sequence[int]], origins: Any, directions: Any
) -> Sequence[int]:
    """The rays' leading shape; ValueError if the shapes do not broadcast."""
    try:
        return broadcast(origins.shape[:-1], directions.shape[:-1])
    except (ValueError, RuntimeError):  # RuntimeError: PyTorch
        raise ValueError(
            f"origins and directions: shapes {tuple(origins.shape)} and "
            f"{tuple(directions.shape)} do not broadcast against each other"
        ) from None


def checked_vertices(vertices: Any, is_float: bool) -> Any:
    """Vertices in one array, whose dtype is floating-point or not."""
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise ValueError(f"vertices: expected shape (V, 3), got {tuple(vertices.shape)}")
    if not is_float:
        raise TypeError(f"vertices: expected floating-point numbers, got dtype {vertices.dtype}")
    return vertices
