"""Stores of rays, and comparing stores of hits with a tracer's answers."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import raystream as rs
from conftest import assert_same_bits

OPTIONS = {
    "first_hit": {},
    "any_hit": {},
    "count_hits": {"crossings": "surfaces"},
    "multi_hit": {},
}
COLUMNS = {
    "first_hit": ("t", "u", "v", "prim_id", "mesh_id", "face_id", "status"),
    "any_hit": ("hit",),
    "count_hits": ("count",),
    "multi_hit": ("ray_splits", "t", "u", "v", "prim_id", "mesh_id", "face_id", "status"),
}


def cornell_rays(shape, seed=7) -> dict[str, np.ndarray]:
    """Rays into the Cornell box from before it; one in 16 is invalid."""
    rng = np.random.default_rng(seed)
    directions = rng.normal((0, 0, 3), 1, (*shape, 3)).astype(np.float32)
    directions[rng.random(shape) < 1 / 16] = 0.0
    origins = np.broadcast_to([278.0, 273.0, -800.0], (*shape, 3)).copy()
    return {"origins": origins, "directions": directions}


def write_store(path: Path, arrays: dict[str, np.ndarray], chunk=None, zarr_format=3, **options):
    """Write arrays to a group; `chunk` is of the leading axes."""
    import zarr

    group = zarr.create_group(path, zarr_format=zarr_format)
    for name, values in arrays.items():
        lengths = values.shape if chunk is None else (*chunk, 3)[: values.ndim]
        lengths = tuple(max(length, 1) for length in lengths)
        array = group.create_array(
            name, shape=values.shape, chunks=lengths, dtype=values.dtype, **options
        )
        array[...] = values
    return path


def read_store(path: Path) -> dict[str, np.ndarray]:
    import zarr

    return {name: array[...] for name, array in zarr.open_group(path, mode="r").arrays()}


def assert_tracers(found: dict[str, np.ndarray], tracer: rs.Tracer, query, rays, options) -> None:
    """Compare bit for bit with a tracer's answer for all rays at once."""
    expected = getattr(tracer, query)(**rays, **options)
    assert set(found) == set(COLUMNS[query])
    for name, array in found.items():
        is_array = isinstance(expected, np.ndarray)
        assert_same_bits(array, expected if is_array else getattr(expected, name))


def content_of(folder: Path) -> dict[str, bytes]:
    """All files in a folder."""
    return {
        str(file.relative_to(folder)): file.read_bytes()
        for file in folder.rglob("*")
        if file.is_file()
    }
