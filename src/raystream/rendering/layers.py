"""Layers (AOVs): extra values per pixel, their kinds and their channels in EXR files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True)
class LayerKind:
    """A layer that renderers write.

    Attributes
    ----------
    width : {1, 3}
        Numbers per pixel.
    dtype : type
    fold : {"mean", "first"}
        How a pixel's samples are combined.
    empty : float
        Value of a pixel without samples.
    """

    width: int
    dtype: type[np.float32] | type[np.int32]
    fold: Literal["mean", "first"]
    empty: float

    @property
    def shape(self) -> tuple[int, ...]:
        """The layer's shape after (H, W)."""
        return () if self.width == 1 else (self.width,)


#: The layers of renderers, by name: values at the first hits of a pixel's samples. Misses do not
#: count, except in emission, where they see the background. Depth is the distance along the ray
#: in scene units; normals are in world space, and their means are shorter than 1 where they
#: differ; albedo and emission are linear RGB.
LAYERS: dict[str, LayerKind] = {
    "depth": LayerKind(1, np.float32, "mean", np.inf),
    "normal": LayerKind(3, np.float32, "mean", 0.0),
    "albedo": LayerKind(3, np.float32, "mean", 0.0),
    "prim_id": LayerKind(1, np.int32, "first", -1.0),
    "emission": LayerKind(3, np.float32, "mean", 0.0),
}

#: Channels of the normals.
_NORMAL = ("N.X", "N.Y", "N.Z")

#: Longest name in bytes: EXR allows 255 for a channel.
_MAX_NAME = 240


def choose_layers(names: str | Iterable[str] | None) -> tuple[str, ...]:
    """Validate names of layers; return them in the order of `LAYERS`.

    Parameters
    ----------
    names : "all", iterable of str, or None
        None selects no layers.

    Raises
    ------
    ValueError
        If a name is unknown.
    """
    if names is None:
        return ()
    if isinstance(names, str) and names == "all":
        return tuple(LAYERS)
    chosen = [names] if isinstance(names, str) else list(names)
    if isinstance(names, str) or not all(name in LAYERS for name in chosen):
        known = ", ".join(repr(known) for known in LAYERS)
        raise ValueError(f"layers: expected 'all' or a list of {known}, got {names!r}")
    return tuple(name for name in LAYERS if name in chosen)


def check_layers(
    layers: Mapping[str, ArrayLike] | None, size: tuple[int, int]
) -> dict[str, NDArray[Any]]:
    """Convert layers to arrays.

    Parameters
    ----------
    layers : mapping of str to array_like of shape (H, W) or (H, W, 3), optional
        Floats, or integers that fit into 32 bits.
    size : (int, int)
        Height and width.

    Returns
    -------
    dict of str to ndarray
        float32 or int32.

    Raises
    ------
    ValueError
        If a name is not valid for a channel, a shape is wrong, or a layer is not numeric.
    """
    checked = {}
    for name, values in (layers or {}).items():
        if not (name.isprintable() and _fits(name)):
            raise ValueError(f"layers: expected names of 1 to {_MAX_NAME} letters, got {name!r}")
        layer = np.asarray(values)
        if layer.shape not in (size, (*size, 3)):
            expected = f"{size} or {(*size, 3)}"
            raise ValueError(f"layers: expected {name!r} of shape {expected}, got {layer.shape}")
        checked[name] = np.ascontiguousarray(layer, _dtype_for(name, layer))
    return checked


def _fits(name: str) -> bool:
    return 0 < len(name.encode(errors="replace")) <= _MAX_NAME


def _dtype_for(name: str, layer: NDArray[Any]) -> type[np.float32] | type[np.int32]:
    if layer.dtype.kind == "f":
        return np.float32
    limits = np.iinfo(np.int32)
    if layer.dtype.kind not in "bui":
        raise ValueError(f"layers: expected {name!r} of numbers, got dtype {layer.dtype}")
    if layer.min() < limits.min or layer.max() > limits.max:
        raise ValueError(f"layers: {name!r} has integers that do not fit into 32 bits")
    return np.int32


def channels_of(layers: Mapping[str, NDArray[Any]]) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the channels of layers: ``Z`` for depth, ``N.X`` and so on for normals.

    Other layers of three numbers have ``name.R``, ``name.G`` and ``name.B``; those of one
    number, their name.
    """
    for name, layer in layers.items():
        if layer.ndim == 2:
            yield ("Z" if name == "depth" else name), layer
        else:
            for k, channel in enumerate(_NORMAL if name == "normal" else _colors(name)):
                yield channel, layer[:, :, k]


def layers_of(channels: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """The inverse of `channels_of`; channels that do not form a triple become layers of one."""
    layers: dict[str, NDArray[Any]] = {}
    rest = dict(channels)
    for channel in channels:
        prefix, dot, last = channel.rpartition(".")
        if not (prefix and dot) or (last != "R" and channel != _NORMAL[0]):
            continue
        triple, name = (_colors(prefix), prefix) if last == "R" else (_NORMAL, "normal")
        planes = [channels[part] for part in triple if part in channels]
        is_one = len(planes) == 3 and len({plane.dtype for plane in planes}) == 1
        if is_one and name not in channels and name not in layers:
            layers[name] = np.stack(planes, axis=-1)
            for part in triple:
                del rest[part]
    for channel, plane in rest.items():
        is_depth = channel == "Z" and "depth" not in channels and "depth" not in layers
        layers["depth" if is_depth else channel] = plane
    return layers


def _colors(name: str) -> tuple[str, ...]:
    return tuple(f"{name}.{letter}" for letter in "RGB")
