"""LibraryHits and LibraryMultiHits: results of queries in arrays of the caller's library."""

from __future__ import annotations

from typing import Any

from raystream.core.hits import Hits, MultiHits
from raystream.core.libraries import Library, as_index, library_of

_DERIVED = (
    "instance_id",
    "mesh_id",
    "mesh_prim_id",
    "face_id",
    "material_id",
    "positions",
    "normals",
)
_SHADING = ("shading_normals", "texcoords")
_COLUMNS = ("t", "u", "v", "prim_id", *_DERIVED, *_SHADING)


class LibraryColumns:
    """Columns of hits, converted when they are first read."""

    _hits: Any
    _library: Library
    _of_rays: frozenset[str]
    _of_rows: frozenset[str]

    def __init__(self, hits: Any, library: Library) -> None:
        self._hits, self._library = hits, library

    def __getattr__(self, name: str) -> Any:
        is_of_rays = name in self._of_rays
        if not is_of_rays and name not in self._of_rows:
            raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")
        try:
            array = getattr(self._hits, name)
        except AttributeError:
            raise AttributeError(f"{name}: not available on a GPU; see host()") from None
        if array is not None:
            array = (self._library.of_rays if is_of_rays else self._library.of_rows)(array)
        self.__dict__[name] = array
        return array

    def of_rays(self, array: Any) -> Any:
        """An array of the library from NumPy's of the rays' leading shape, or that and one axis."""
        return self._library.of_rays(array)

    def __repr__(self) -> str:
        return f"{type(self).__name__} of {self._hits!r}"


class LibraryHits(LibraryColumns):
    """The nearest hit of each ray, in arrays of the library that the rays came from.

    The result of a query for rays of PyTorch, JAX, CuPy and xarray. Arrays are made when they are
    first read, and share memory with those of `host`, except where JAX copies them.

    Attributes
    ----------
    t, u, v, prim_id, status, sectors
        See `Hits`; of shape S, on the device of the rays.
    instance_id, mesh_id, mesh_prim_id, face_id, material_id, positions, normals, shading_normals, texcoords
        See `Hits`. For rays on a GPU, only `host` has them, except `instance_id` in scenes with
        instances.

    Notes
    -----
    With xarray they have the dimensions and coordinates of `origins`, or of `directions` if
    `origins` is not a DataArray, except where the two are broadcast to another shape.
    """  # noqa: E501 - numpydoc wants the names in one line

    _of_rays = frozenset((*_COLUMNS, "status", "sectors", "is_hit"))
    _of_rows = frozenset()

    def host(self) -> Hits:
        """The hits in NumPy arrays; from a GPU they are copied, after waiting for it.

        Returns
        -------
        Hits
        """
        return self._hits if isinstance(self._hits, Hits) else self._hits.host()

    def spawn(self, directions: Any) -> tuple[Any, Any]:
        """Make rays that leave the surfaces hit; see `Hits.spawn`.

        Parameters
        ----------
        directions : array_like that broadcasts to the hits' shape + (3,), real

        Returns
        -------
        origins, directions : arrays of the library, of the hits' shape + (3,)
        """
        origins, directions = self.host().spawn(directions)
        return self._library.of_rays(origins), self._library.of_rays(directions)

    def __getitem__(self, index: Any) -> LibraryHits:
        """Pick rays, with any index that NumPy takes for the leading shape, or one in tensors."""
        return LibraryHits(self.host()[as_index(index)], self._library)

    def ravel(self) -> LibraryHits:
        """The same hits in shape (N,)."""
        return LibraryHits(self.host().ravel(), self._library)


class LibraryMultiHits(LibraryColumns):
    """All hits of each ray, in arrays of the library that the rays came from.

    Attributes
    ----------
    ray_splits, t, u, v, prim_id, status
        See `MultiHits`.
    counts, ray_id, instance_id, mesh_id, mesh_prim_id, face_id, material_id, positions, normals, shading_normals, texcoords
        See `MultiHits`. For rays on a GPU, only `host` has them, except `instance_id` in scenes
        with instances.
    """  # noqa: E501 - numpydoc wants the names in one line

    _of_rays = frozenset(("status", "counts"))
    _of_rows = frozenset((*_COLUMNS, "ray_splits", "ray_id"))

    def host(self) -> MultiHits:
        """The hits in NumPy arrays; from a GPU they are copied, after waiting for it.

        Returns
        -------
        MultiHits
        """
        return self._hits if isinstance(self._hits, MultiHits) else self._hits.host()


def in_library(found: Any, origins: Any, directions: Any) -> Any:
    """A query's result in arrays of the library that its rays came from.

    Parameters
    ----------
    found : Hits, MultiHits, those on a GPU, or an array of the rays' shape
    origins, directions : array_like
        As the caller gave them.

    Returns
    -------
    LibraryHits, LibraryMultiHits or an array of the library
        `found` itself, if the rays are in arrays of NumPy or an unknown library.
    """
    library = library_of(origins, directions)
    if library is None:
        return found
    if hasattr(found, "ray_splits"):
        return LibraryMultiHits(found, library)
    return LibraryHits(found, library) if hasattr(found, "prim_id") else library.of_rays(found)
