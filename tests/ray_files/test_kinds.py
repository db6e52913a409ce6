"""Ray files of spheres, height fields and triangles in float64 hold what queries return."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from extras import need

need("zarr")

import zarr

import raystream as rs

SCENES = {
    "spheres": (rs.Scene.spheres([[0, 0, 5], [0, 0, 8]], 1.0), "float32"),
    "fields": (rs.Scene.height_field(np.eye(4), origin=(-2, -2, 5)), "float32"),
    "float64": (rs.load("three_boxes"), "float64"),
}


@pytest.mark.parametrize("kind", SCENES)
@pytest.mark.parametrize("query", ["first_hit", "multi_hit"])
def test_files_hold_what_queries_return(kind: str, query: str, tmp_path: Path) -> None:
    scene, precision = SCENES[kind]
    tracer = rs.Tracer(scene, precision=precision)
    low, high = scene.bounds
    rng = np.random.default_rng(1)
    origins = rng.uniform(low - 1.0, high + 1.0, (500, 3))
    rays = {"origins": origins, "directions": rng.uniform(low, high, (500, 3)) - origins}
    group = zarr.open_group(tmp_path / "rays.zarr", mode="w")
    for name, array in rays.items():
        group.create_array(name, data=array)
    rs.query_zarr(tracer, tmp_path / "rays.zarr", tmp_path / "hits.zarr", query=query)
    stored = zarr.open_group(tmp_path / "hits.zarr", mode="r")
    wanted = getattr(tracer, query)(**rays)
    for name in ("t", "u", "v", "prim_id", "mesh_id"):
        column = stored[name][:]
        assert column.dtype == getattr(wanted, name).dtype
        assert column.tobytes() == getattr(wanted, name).tobytes()


def test_other_spheres_are_another_query(tmp_path: Path) -> None:
    from raystream.ray_files.identity import scene_digest

    one, same, other = (
        scene_digest(rs.Scene.spheres([[0, 0, z]], 1.0).triangles) for z in (0.0, 0.0, 1.0)
    )
    assert one == same != other
