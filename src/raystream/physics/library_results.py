"""LibraryThickness and LibraryLidarReturns: physics in arrays of the caller's library."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from raystream.core.libraries import library_of
from raystream.core.library_hits import LibraryColumns

if TYPE_CHECKING:
    from raystream.physics.lidar import LidarReturns
    from raystream.physics.thickness import Grouping, Thickness

_ROWS = ("ray_splits", "ray_id")
_SEGMENTS = ("t_entry", "t_exit", "path_length", "mesh_id", "material_id", "instance_id")
_PRIMS = ("entry_prim_id", "exit_prim_id")
_UNPAIRED = ("ray", "t", "prim_id", "mesh_id", "instance_id", "kind")
_MESHES = ("mesh_is_closed", "mesh_is_flipped")
_RETURNS = ("ranges", "positions", "intensity", "incidence_angle", "return_number", "return_count")
_OF_RETURNS = ("prim_id", "mesh_id", "material_id", "instance_id")


class LibraryThickness(LibraryColumns):
    """Segments of rays inside closed meshes, in arrays of the library that the rays came from.

    The result of `thickness` for rays of PyTorch, JAX, CuPy and xarray. Arrays are made when they
    are first read, and share memory with those of `host`, except where JAX copies them.

    Attributes
    ----------
    ray_splits, ray_id, t_entry, t_exit, path_length, mesh_id, material_id, instance_id, entry_prim_id, exit_prim_id
        See `Thickness`.
    unpaired_ray, unpaired_t, unpaired_prim_id, unpaired_mesh_id, unpaired_instance_id, unpaired_kind
        See `Thickness`.
    counts, status, is_complete, mesh_is_closed, mesh_is_flipped
        See `Thickness`; with xarray, those of the rays' shape have the rays' dimensions.
    mesh_names, material_names : tuple of str
    """  # noqa: E501 - numpydoc wants the names in one line

    _of_rays = frozenset(("status", "counts", "is_complete"))
    _of_rows = frozenset(
        (*_ROWS, *_SEGMENTS, *_PRIMS, *_MESHES, *(f"unpaired_{name}" for name in _UNPAIRED))
    )

    def host(self) -> Thickness:
        """The segments in NumPy arrays."""
        return self._hits

    @property
    def mesh_names(self) -> tuple[str, ...]:
        """Names of the scene's meshes."""
        return self.host().mesh_names

    @property
    def material_names(self) -> tuple[str, ...]:
        """Names of the scene's materials."""
        return self.host().material_names

    def total_length(self, by: Grouping | None = None) -> Any:
        """Sum up the lengths of each ray's segments; see `Thickness.total_length`."""
        return self.of_rays(self.host().total_length(by))


class LibraryLidarReturns(LibraryColumns):
    """Returns of pulses, in arrays of the library that the rays came from.

    The result of `lidar_returns` for rays of PyTorch, JAX, CuPy and xarray. Arrays are made when
    they are first read, and share memory with those of `host`, except where JAX copies them.

    Attributes
    ----------
    ray_splits, ray_id, ranges, positions, intensity, incidence_angle, return_number, return_count, prim_id, mesh_id, material_id, instance_id
        See `LidarReturns`.
    counts, status
        See `LidarReturns`; with xarray, they have the rays' dimensions.
    """  # noqa: E501 - numpydoc wants the names in one line

    _of_rays = frozenset(("status", "counts"))
    _of_rows = frozenset((*_ROWS, *_RETURNS, *_OF_RETURNS))

    def host(self) -> LidarReturns:
        """The returns in NumPy arrays."""
        return self._hits


def in_library_of(origins: Any, directions: Any, found: Any, kind: type[LibraryColumns]) -> Any:
    """A result in arrays of the library that the rays came from; itself for NumPy's rays."""
    library = library_of(origins, directions)
    return found if library is None else kind(found, library)
