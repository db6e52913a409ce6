"""Cut-outs: the filter that analyses pass to their queries, so that rays pass through holes."""

from __future__ import annotations

import importlib
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

#: What looks opacity up. It is named, as the rooms of devices are, and not imported: X-ray images
#: need `physics`, whose analyses need this, so that neither room can be before the other.
_OPACITY = "raystream.rendering.opacity"

#: Opacity by scene, and by which meshes are solid: tables are made once, not for each call.
_known: WeakKeyDictionary[Any, dict[bytes, Any]] = WeakKeyDictionary()


def cutouts_of(tracer: Any, is_wanted: bool, is_solid: NDArray[np.bool_] | None = None) -> Any:
    """The opacity of the surfaces that an analysis traces; None if all are opaque.

    Parameters
    ----------
    tracer : Tracer
    is_wanted : bool
        The analysis's argument ``cutouts``.
    is_solid : ndarray of shape (M,), bool, optional
        Meshes whose cut-outs count as surface.

    Returns
    -------
    rendering.opacity.Opacity or None
        Without chance: a surface without a cut-off is there where its opacity is a half or more.

    Raises
    ------
    ValueError
        If there are cut-outs, and the tracer counts.
    """
    scene = tracer.scene
    if not is_wanted or scene.is_opaque:
        return None
    opacity = _opacity_of(scene, tracer.structure.triangles, is_solid)
    if opacity is not None and tracer.is_counting:
        raise ValueError(
            "cutouts=True: a tracer with counters=True counts whole queries, and filters take "
            "several; use another tracer, or cutouts=False"
        )
    return opacity


def _opacity_of(scene: Any, triangles: Any, is_solid: NDArray[np.bool_] | None) -> Any:
    known = _known.setdefault(scene, {})
    key = b"" if is_solid is None else is_solid.tobytes()
    if key not in known:
        counts = np.diff(triangles.mesh_splits)
        solid = None if is_solid is None else np.repeat(is_solid, counts)
        known[key] = importlib.import_module(_OPACITY).Opacity.of(scene, None, solid)
    return known[key]
