"""Attenuation of rays by solids: the Beer-Lambert law."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from raystream.physics.group_values import group_values
from raystream.physics.library_results import LibraryThickness
from raystream.physics.thickness import Grouping, Thickness

__all__ = ["attenuation"]


def attenuation(
    thickness: Thickness | LibraryThickness,
    coefficients: Any,
    *,
    by: Grouping = "material",
    incomplete: Literal["nan", "ignore"] = "nan",
) -> Any:
    """Compute the fraction of each ray that solids transmit.

    Parameters
    ----------
    thickness : Thickness or LibraryThickness
    coefficients : mapping, or array_like of shape () or (M,), real
        Linear attenuation coefficients, in reciprocal scene units; not negative. A mapping
        maps materials (or meshes), by name or number, to coefficients, and may omit those that
        no ray crosses. One number applies to all.
    by : {"material", "mesh"}
        Whether there is a coefficient for each material of the scene, or for each mesh.
    incomplete : {"nan", "ignore"}
        Result for rays whose `Thickness.is_complete` is False: NaN, or the transmittance of
        the segments that were found.

    Returns
    -------
    array of the rays' leading shape, float64
        In the library of the rays:
        exp(-sum of coefficient * path length over the ray's segments), 1 for a ray that
        misses everything.

    Raises
    ------
    ValueError
        If a coefficient is negative or NaN, or missing for a material or mesh that a ray
        crosses; if a name is unknown or ambiguous; if an array's shape is wrong.
    TypeError
        If coefficients are not real numbers.

    Notes
    -----
    Where segments of different meshes overlap, both count: `thickness` warns of it, and with
    ``nested="inner"`` there is no overlap. Scattering is not modelled: the result is the fraction
    of the primary beam.

    Examples
    --------
    >>> import raystream as rs
    >>> tracer = rs.Tracer(rs.load("cornell"))
    >>> found = rs.thickness(tracer, [200.0, 100.0, -800.0], [0.0, 0.0, 1.0], t_max=1200.0)
    >>> round(rs.attenuation(found, {"short block": 0.01}, by="mesh").item(), 3)
    0.176
    """
    if incomplete not in ("nan", "ignore"):
        raise ValueError(f"incomplete: expected 'nan' or 'ignore', got {incomplete!r}")
    if isinstance(thickness, LibraryThickness):
        host = attenuation(thickness.host(), coefficients, by=by, incomplete=incomplete)
        return thickness.of_rays(host)
    ids, names = thickness.group_ids(by), thickness.group_names(by)
    table = group_values("coefficients", coefficients, names, by)
    missing = np.unique(ids[np.isnan(table[ids])])
    if len(missing):
        known = ", ".join(f"{i} ({names[i]!r})" for i in missing[:5])
        raise ValueError(f"coefficients: none for {by} {known}, which rays cross")
    ray_count = len(thickness.ray_splits) - 1
    depth = np.bincount(thickness.ray_id, table[ids] * thickness.path_length, ray_count)
    passed: NDArray[np.float64] = np.exp(-depth).reshape(thickness.status.shape)
    if incomplete == "nan":
        passed[~thickness.is_complete] = np.nan
    return passed
