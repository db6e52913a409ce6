"""Mitsuba 3 on the CPU (Embree within, compiled by Dr.Jit), as a contender."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import drjit
import mitsuba
import numpy as np
from numpy.typing import NDArray

from raystream.bench.contenders.base import Contender, FirstHits, Geometry, Rays, UnavailableError

_VARIANT = "llvm_ad_rgb"


class Mitsuba(Contender):
    """``ray_intersect_preliminary`` and ``ray_test``, with both coherence hints.

    Parameters
    ----------
    threads : int
    options : mapping
        Of the scene, such as ``embree_use_robust_intersections``: whether Embree's tests let no
        ray through an edge (Mitsuba's default: False).
    """

    modes = ("incoherent", "coherent")
    queries = frozenset(("first", "any"))
    has_instances = True
    notes = "no query for all hits; both of its modes are timed, and the better one counts"

    def __init__(self, threads: int, options: Mapping[str, Any]) -> None:
        self._options = dict(options)
        self.is_watertight = bool(options.get("embree_use_robust_intersections"))
        mitsuba.set_variant(_VARIANT)
        drjit.set_thread_count(threads)
        try:
            mitsuba.Float([1.0, 2.0]).numpy()
        except RuntimeError as error:  # LLVM is missing
            raise UnavailableError(str(error)) from error
        self.version = str(mitsuba.__version__)

    def build(self, geometry: Geometry) -> None:
        """Make a scene with one mesh, or of instances of shape groups."""
        scene: dict[str, Any] = {"type": "scene", **self._options}
        if geometry.placed is None:
            scene["triangles"] = _mesh(geometry.vertices, geometry.faces)
        else:
            for k, one in enumerate(geometry.objects()):
                scene[f"object{k}"] = {"type": "shapegroup", "triangles": _mesh(*one)}
            placed = zip(geometry.placed.object_ids, geometry.placed.transforms, strict=True)
            for k, (object_id, transform) in enumerate(placed):
                matrix = np.vstack([transform, [0.0, 0.0, 0.0, 1.0]])
                scene[f"instance{k}"] = {
                    "type": "instance",
                    "to_world": mitsuba.ScalarTransform4f(matrix),
                    "shape": {"type": "ref", "id": f"object{object_id}"},
                }
        self._built = mitsuba.load_dict(scene)
        drjit.sync_thread()

    def first_hit(self, rays: Rays, mode: str) -> FirstHits:
        """Find the nearest hit of each ray."""
        found = self._built.ray_intersect_preliminary(_rays(rays), coherent=mode == "coherent")
        drjit.eval(found.t, found.prim_index)  # both in one kernel
        return FirstHits(found.t.numpy(), found.prim_index.numpy())

    def any_hit(self, rays: Rays, mode: str) -> NDArray[np.bool_]:
        """Test whether each ray hits anything."""
        # By keyword: the second positional argument is the mask of active rays.
        seen: NDArray[np.bool_] = self._built.ray_test(
            _rays(rays), coherent=mode == "coherent"
        ).numpy()
        return seen


def _mesh(vertices: NDArray[np.float32], faces: NDArray[np.int32]) -> Any:
    mesh = mitsuba.Mesh("triangles", len(vertices), len(faces))
    parameters = mitsuba.traverse(mesh)
    parameters["vertex_positions"] = vertices.ravel()
    parameters["faces"] = faces.view(np.uint32).ravel()
    parameters.update()
    return mesh


def _rays(rays: Rays) -> Any:
    # The kernel reads the rows as they are. Point3f(origins.T) is slower: see docs/performance.rst.
    origins, directions = (mitsuba.Float(one.ravel()) for one in rays.rows())
    made = mitsuba.Ray3f(
        drjit.unravel(mitsuba.Point3f, origins), drjit.unravel(mitsuba.Vector3f, directions)
    )
    if np.isfinite(rays.t_max):
        made.maxt = mitsuba.Float(rays.t_max)
    return made
