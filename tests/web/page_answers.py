"""Answers of exported pages, compared with the CPU's."""

from __future__ import annotations

import base64
import io
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

import raystream as rs
from raystream.scene.scene import Scene
from web.pages import Exported

#: Origins and directions.
Rays = tuple[NDArray[np.float64], NDArray[np.float64]]


def rays_of(scene: Scene, count: int = 2000, seed: int = 0) -> Rays:
    """Rays in and around a scene, with directions of any length."""
    rng = np.random.default_rng(seed)
    low, high = scene.bounds
    origins = rng.uniform(low - 0.2 * (high - low), high + 0.2 * (high - low), (count, 3))
    directions = rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(-3, 3, (count, 1))
    return origins, directions


def first_hits(page: Exported, structure: str, rays: Rays) -> tuple[NDArray[Any], NDArray[Any]]:
    """Trace rays in a page; returns t, -1 for a miss, and prim_id."""
    found = page.run(
        """async (page, [structure, rays]) => {
            const hits = await page.queriesOf(structure).firstHit(Float64Array.from(rays));
            return {...hits, t: hits.t.map(t => Number.isFinite(t) ? t : -1)};
        }""",
        [structure, np.column_stack(rays).reshape(-1).tolist()],
    )
    return np.array(found["t"]), np.array(found["primId"])


def assert_same_hits(
    page: Exported, scene: Scene, structure: str, rays: Rays, least_share: float = 0.3
) -> None:
    """prim_ids are equal but where two hits are as near as rounding, and so is t."""
    t, prim_id = first_hits(page, structure, rays)
    tracer = rs.Tracer(scene)
    hits = tracer.first_hit(*rays)
    assert (hits.is_hit == (prim_id >= 0)).all()
    np.testing.assert_allclose(t[hits.is_hit], hits.t[hits.is_hit], rtol=1e-5)
    differ = np.flatnonzero(prim_id != hits.prim_id)
    for ray in differ:  # the other triangle is as near
        every = tracer.multi_hit(rays[0][ray], rays[1][ray])
        other = every.t[every.prim_id == prim_id[ray]]
        assert other == pytest.approx([hits.t[ray]], rel=1e-5)
    assert len(differ) <= len(prim_id) // 100
    assert hits.is_hit.mean() > least_share


def assert_same_light(light: NDArray[np.float32], before: NDArray[np.float32]) -> None:
    """Images of the same samples: what differs are single rays along edges."""
    assert light.shape == before.shape
    close = np.isclose(light, before, rtol=1e-3, atol=1e-3).all(axis=2)
    assert close.mean() > 0.99
    assert before.std() > 0.05


def picture(page: Exported) -> NDArray[np.int16]:
    """What the canvas shows, shape (H, W, 3): read before the browser takes it away."""
    address = page.run(
        """async page => {
            const shown = page.display.show();
            const address = page.canvas.toDataURL();
            await shown;
            return address;
        }"""
    )
    png = base64.b64decode(address.partition(",")[2])
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(np.int16)
