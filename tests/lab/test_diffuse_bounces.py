"""Bounces leave on the incoming side, with cosine-weighted directions."""

from __future__ import annotations

import numpy as np

from extras import need

need("raystream_lab")

import raystream as rs
from raystream_lab.diffuse_bounces import bounce_rays, cosine_directions


def test_directions_follow_the_cosine() -> None:
    normals = np.tile([0.0, 0.0, 1.0], (200_000, 1))
    away = cosine_directions(normals, [0.3, 0.0, 1.0], np.random.default_rng(5))  # seen from behind
    cosines = -away[:, 2] / np.linalg.norm(away, axis=1)
    assert cosines.min() > 0.0
    # Density 2 cos: a mean of 2/3, and a mean square of 1/2; 4 sigma.
    assert abs(cosines.mean() - 2 / 3) < 4 * 0.2357 / np.sqrt(len(cosines))
    assert abs((cosines**2).mean() - 0.5) < 4 * 0.2887 / np.sqrt(len(cosines))


def test_bounces_start_at_hits() -> None:
    scene = rs.load("cornell")
    tracer = rs.Tracer(scene, "brute")
    origins, directions = scene.camera_for(1.0).rays(16, 16)
    hits = tracer.first_hit(origins, directions)
    starts, away = bounce_rays(hits, directions)
    assert starts.shape == away.shape == (int(hits.is_hit.sum()), 3)
    assert np.allclose(starts, hits.positions[hits.is_hit], atol=0.01)
    normals, arriving = hits.normals[hits.is_hit], directions[hits.is_hit]
    facing = np.sign((normals * arriving).sum(axis=1)) * (normals * away).sum(axis=1)
    assert (facing < 0.0).all()
