"""First images of models that were hard to see, by nothing but their names and a mode."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

import raystream as rs
from meshes import grid_floor
from solid_meshes import box_mesh as solid

WIDTH, HEIGHT = 64, 48

MATERIALS = """\
newmtl stone
Kd 0.6 0.55 0.5
newmtl leaf
Kd 0.2 0.5 0.1
newmtl glow
Ke 0.02 0.02 0.01
"""

#: Most of the pixels in the lowest or the highest tenth of the range, and least on the model.
MOST_EXTREME, LEAST_SHOWN = 0.95, 0.20


def box_mesh(low, high):
    mesh = solid(low, high)
    return mesh.vertices, mesh.faces


def save(path, parts):
    """An OBJ file of meshes, each with a material of the file beside it."""
    lines, first = [f"mtllib {path.stem}.mtl"], 1
    for vertices, faces, material in parts:
        lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices]
        lines += [f"usemtl {material}"]
        lines += [f"f {a} {b} {c}" for a, b, c in np.asarray(faces) + first]
        first += len(vertices)
    path.write_text("\n".join(lines))
    path.with_suffix(".mtl").write_text(MATERIALS)


def world(path):
    """A large ground with towers, of whose faces a dozen glow weakly."""
    rng = np.random.default_rng(1)
    vertices, faces = grid_floor(40)
    vertices = (vertices + [1.0, 0.0, 1.0]) * 200.0
    parts = [(vertices, faces, "stone")]
    for k in range(60):
        x, z = rng.uniform(40, 360, 2)
        low = np.array([x, 0.0, z])
        box = box_mesh(low, low + [12.0, rng.uniform(8.0, 40.0), 12.0])
        parts.append((*box, "glow" if k == 0 else "stone"))
    save(path, parts)


def interior(path):
    """A closed room with furniture, whose walls are seen from inside only."""
    vertices, faces = box_mesh((0, 0, 0), (6, 2.7, 4))
    parts = [(vertices, np.asarray(faces)[:, ::-1], "stone")]
    for low, high in (((0.3, 0, 0.3), (1.5, 0.8, 1.2)), ((2.4, 0, 1.6), (3.7, 0.7, 2.5))):
        parts.append((*box_mesh(low, high), "leaf"))
    save(path, parts)


def plant(path):
    """Leaves around a stem, and a few triangles thirty times as far away."""
    rng = np.random.default_rng(2)
    places = rng.normal(size=(1500, 1, 3))
    places *= rng.uniform(0.5, 1.0, (1500, 1, 1)) / np.linalg.norm(places, axis=2, keepdims=True)
    places = places * [1.2, 0.8, 1.2] + [0, 1.2, 0]
    leaves = places + rng.normal(size=(1500, 3, 3)) * 0.12
    strays = 30.0 * rng.normal(size=(6, 1, 3)) + rng.normal(size=(6, 3, 3)) * 0.02
    corners = np.concatenate([leaves, strays]).reshape(-1, 3)
    parts = [(corners, np.arange(len(corners)).reshape(-1, 3), "leaf")]
    parts.append((*box_mesh((-0.05, 0, -0.05), (0.05, 1.0, 0.05)), "stone"))
    save(path, parts)


@pytest.mark.parametrize("mode", rs.MODES)
@pytest.mark.parametrize("make", [world, interior, plant])
def test_a_first_image_shows_the_model(run, tmp_path, make, mode):
    model = tmp_path / f"{make.__name__}.obj"
    make(model)
    assert run("render", model, "--mode", mode, "--size", f"{WIDTH}x{HEIGHT}").code == 0
    with Image.open(model.with_suffix(".png")) as image:
        values = np.asarray(image.convert("RGB"))
    assert (values.max(axis=2) < 25.5).mean() <= MOST_EXTREME
    assert (values.min(axis=2) > 229.5).mean() <= MOST_EXTREME
    scene = rs.load(model)
    rays = scene.camera_for(WIDTH / HEIGHT).rays(WIDTH, HEIGHT)
    assert (rs.Tracer(scene).first_hit(*rays).prim_id >= 0).mean() >= LEAST_SHOWN
