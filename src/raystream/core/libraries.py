"""Array libraries of callers: results become arrays of the library that the rays came from."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np


class Library:
    """Makes arrays of a caller's library from NumPy's and those on a GPU, without a copy.

    Parameters
    ----------
    convert : callable
        Makes one array.
    """

    def __init__(self, convert: Callable[[Any], Any]) -> None:
        self._convert = convert

    def of_rows(self, array: Any) -> Any:
        """An array of the library from one whose rows are hits of any ray."""
        return self._convert(array)

    def of_rays(self, array: Any) -> Any:
        """An array of the library from one of the rays' leading shape, or that and one axis."""
        return self._convert(array)


class _Labelled(Library):
    """xarray: results have the dimensions and coordinates of the rays.

    Parameters
    ----------
    rays : xarray.DataArray of shape S + (3,)
        Origins or directions.
    """

    def __init__(self, rays: Any) -> None:
        super().__init__(type(rays))
        self._rays: Any = rays

    def of_rays(self, array: Any) -> Any:
        """An array with the names that the rays have for its axes, if their shapes agree."""
        rays = self._rays
        names, lengths = rays.dims[:-1], rays.shape[:-1]
        if array.shape[: len(lengths)] != lengths or array.ndim > rays.ndim:
            return self._convert(array)  # broadcast against the other array of the rays
        if array.ndim == rays.ndim:
            same = array.shape == rays.shape
            names = (*names, rays.dims[-1] if same else "component")
        known = {name: one for name, one in rays.coords.items() if set(one.dims) <= set(names)}
        return type(rays)(array, coords=known, dims=names)


def _to_torch(array: Any) -> Any:
    torch = sys.modules["torch"]
    if not isinstance(array, np.ndarray):
        return torch.from_dlpack(array)
    return torch.from_numpy(array if array.flags.writeable else array.copy())


def _to_jax(array: Any) -> Any:
    jax = sys.modules["jax"]
    if isinstance(array, np.ndarray) and not array.flags.writeable:
        return jax.numpy.asarray(array)
    return jax.dlpack.from_dlpack(array)


def _to_cupy(array: Any) -> Any:
    cupy = sys.modules["cupy"]
    return cupy.asarray(array) if isinstance(array, np.ndarray) else cupy.from_dlpack(array)


#: By the package that defines the type of an array; makes the library from such an array.
_PACKAGES: Mapping[str, Callable[[Any], Library]] = {
    "cupy": lambda _: Library(_to_cupy),
    "jax": lambda _: Library(_to_jax),
    "jaxlib": lambda _: Library(_to_jax),
    "torch": lambda _: Library(_to_torch),
    "xarray": _Labelled,
}

#: The same by type, as types are met; None for those whose results are NumPy's or the GPU's.
_BY_TYPE: dict[type, Callable[[Any], Library] | None] = {np.ndarray: None, list: None, tuple: None}


def library_of(origins: Any, directions: Any) -> Library | None:
    """The library whose arrays the rays are in; None for NumPy and everything unknown.

    Parameters
    ----------
    origins, directions : array_like
        The first that is of a known library decides.
    """
    for values in (origins, directions):
        kind = type(values)
        try:
            make = _BY_TYPE[kind]
        except KeyError:
            make = _BY_TYPE[kind] = _maker(kind)
        if make is not None:
            return make(values)
    return None


def _maker(kind: type) -> Callable[[Any], Library] | None:
    """How to make the library of a type of arrays, or of what it derives from."""
    if issubclass(kind, np.ndarray) or not hasattr(kind, "shape"):
        return None
    for one in kind.__mro__:
        package = one.__module__.partition(".")[0]
        if package == "xarray" and not hasattr(one, "coords"):
            continue  # a Variable, which has no labels
        if package in _PACKAGES:
            return _PACKAGES[package]
    return None


def advice_about(values: Any) -> str:
    """What to do with an array that cannot be read, in a clause; empty if it is not known."""
    package = type(values).__module__.partition(".")[0]
    if package == "torch" and getattr(values, "requires_grad", False):
        return "; raystream.torch.TorchTracer traces it with gradients, .detach() without"
    if package == "jax":
        return "; inside jit, vmap and grad, use raystream.jax.JaxTracer"
    return ""


def as_index(index: Any) -> Any:
    """An index of NumPy's from one that may be, or contain, arrays of another library."""
    if isinstance(index, tuple):
        return tuple(map(as_index, index))
    if hasattr(index, "__array__") and not isinstance(index, np.ndarray):
        return np.asarray(index)
    return index
