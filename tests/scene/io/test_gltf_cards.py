"""Squares in glTF files: texels by their samplers, and the alpha of their vertices."""

from __future__ import annotations

import base64
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import raystream as rs
from raystream.rendering.color import decode_srgb
from raystream.scene.scene import Scene
from scene.io import tiny
from scene.io.tiny import with_buffer

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
ABOVE = rs.Camera((0.5, 0.5, 1), (0.5, 0.5, 0), fov=2 * np.degrees(np.arctan(0.5)))
TEXELS = np.random.default_rng(7).integers(0, 256, (3, 3, 3), dtype=np.uint8)

#: The behaviour of numbers in files, by NumPy's names; the last one is invalid.
PADDING = {33071: "edge", 33648: "symmetric", 10497: "wrap", None: "wrap", 7: "wrap"}

KINDS = {"float32": 5126, "uint8": 5121, "uint16": 5123}


def card(
    tmp_path: Path,
    pixels: np.ndarray[Any, Any],
    material: dict[str, Any] | None,
    colors: np.ndarray[Any, Any] | None = None,
    **sampler: int,
) -> Path:
    """A square whose texture coordinates go from -2 to 3, as they are counted in files."""
    places = np.array([[-2, 3], [3, 3], [3, -2], [-2, -2]], np.float32)
    arrays = [CORNERS, np.array([0, 1, 2, 0, 2, 3], np.uint32), places]
    document = with_buffer(tiny.gltf_document(), *arrays, *([] if colors is None else [colors]))
    document["accessors"] = [
        {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
        {"bufferView": 1, "componentType": 5125, "count": 6, "type": "SCALAR"},
        {"bufferView": 2, "componentType": 5126, "count": 4, "type": "VEC2"},
    ]
    document["nodes"] = [{"mesh": 0}]
    primitive = document["meshes"][0]["primitives"][0]
    primitive["attributes"] |= {"TEXCOORD_0": 2}
    if colors is not None:
        layout = {"type": f"VEC{colors.shape[1]}", "normalized": colors.dtype.kind == "u"}
        kind = KINDS[str(colors.dtype)]
        document["accessors"] += [{"bufferView": 3, "componentType": kind, "count": 4, **layout}]
        primitive["attributes"] |= {"COLOR_0": 3}
    if material is not None:
        document["materials"] = [material]
        primitive["material"] = 0
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "PNG")
    uri = "data:image/png;base64," + base64.b64encode(file.getvalue()).decode()
    document |= {"images": [{"uri": uri}], "textures": [{"source": 0, "sampler": 0}]}
    document["samplers"] = [sampler]
    path = tmp_path / "a.gltf"
    path.write_text(json.dumps(document))
    return path


def seen(path: Path, **options: Any) -> Scene:
    return rs.load(path, **options).replace(camera=ABOVE)


GLOW = {
    "emissiveFactor": [1, 1, 1],
    "emissiveTexture": {"index": 0},
    "pbrMetallicRoughness": {"baseColorFactor": [0, 0, 0, 1]},
}


@pytest.mark.parametrize("across", PADDING)
def test_samplers_wrap_each_axis(tmp_path: Path, across: int | None) -> None:
    for down in PADDING:
        modes = {"wrapS": across, "wrapT": down}
        used = {name: mode for name, mode in modes.items() if mode is not None}
        scene = seen(card(tmp_path, TEXELS, GLOW, **used))
        rows = np.pad(TEXELS, [(6, 6), (0, 0), (0, 0)], PADDING[down])
        expected = decode_srgb(np.pad(rows, [(0, 0), (6, 6), (0, 0)], PADDING[across]))
        found = rs.render(scene, "whitted", (15, 15), 1).pixels
        np.testing.assert_allclose(found, expected, atol=2e-5)


# The alpha of vertices


def coverage(scene: Scene) -> float:
    return float(rs.render(scene, "vis", (32, 32), 1).pixels.any(axis=2).mean())


def leaf(mode: str | None, factor: float = 1.0) -> dict[str, Any]:
    surface = {"baseColorFactor": [1, 1, 1, factor], "baseColorTexture": {"index": 0}}
    return {"pbrMetallicRoughness": surface} | ({} if mode is None else {"alphaMode": mode})


def tint(alpha: float, kind: str = "float32") -> np.ndarray[Any, Any]:
    colors = np.tile([1.0, 0.5, 0.25, alpha], (4, 1))
    return colors.astype(kind) if kind == "float32" else (colors * np.iinfo(kind).max).astype(kind)


PALE = np.full((1, 1, 4), (255, 255, 255, 200), np.uint8)


@pytest.mark.parametrize("instances", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_a_mask_multiplies_the_alphas_of_texture_and_vertices(
    tmp_path: Path, kind: str, instances: bool
) -> None:
    """200 / 255 times 1/2 is below the cutoff of 1/2; times 3/4, above."""
    for alpha, expected in ((0.5, 0.0), (0.75, 1.0), (1.0, 1.0)):
        path = card(tmp_path, PALE, leaf("MASK"), tint(alpha, kind))
        assert coverage(seen(path, instances=instances)) == expected


def test_factor_texture_and_vertices_count(tmp_path: Path) -> None:
    """Each is above the cutoff of 1/2; 0.9 times 0.78 times 0.7 is not."""
    assert coverage(seen(card(tmp_path, PALE, leaf("MASK", 0.9), tint(0.7)))) == 0.0
    assert coverage(seen(card(tmp_path, PALE, leaf("MASK", 0.9), tint(0.75)))) == 1.0


def test_the_cutoff_crosses_a_triangle(tmp_path: Path) -> None:
    """From 0 at the left to 1 at the right: half of the square is there."""
    colors = tint(1.0)
    colors[:, 3] = CORNERS[:, 0]
    white = np.full((1, 1, 4), 255, np.uint8)
    scene = seen(card(tmp_path, white, leaf("MASK"), colors))
    image = rs.render(scene, "vis", (32, 32), 1).pixels.any(axis=2)
    assert not image[:, :16].any()
    assert image[:, 16:].all()


def test_blended_vertices_cover_their_share(tmp_path: Path) -> None:
    scene = seen(card(tmp_path, PALE, leaf("BLEND"), tint(0.5)))
    image = rs.render(scene, "vis", (128, 128), 1).pixels.any(axis=2)
    share = 200 / 255 / 2
    assert abs(image.mean() - share) < 4 * np.sqrt(share * (1 - share) / image.size)


@pytest.mark.parametrize("material", [None, leaf(None), leaf("OPAQUE"), leaf("bent")])
def test_solid_materials_ignore_the_alpha(tmp_path: Path, material: dict[str, Any] | None) -> None:
    scene = seen(card(tmp_path, PALE, material, tint(0.5)))
    np.testing.assert_allclose(scene.meshes[0].colors, tint(0.5)[:, :3])
    assert coverage(scene) == 1.0


@pytest.mark.parametrize("colors", [tint(1.0), tint(0.5)[:, :3].copy()])
def test_colors_without_alpha_stay_three_numbers(
    tmp_path: Path, colors: np.ndarray[Any, Any]
) -> None:
    scene = seen(card(tmp_path, PALE, leaf("MASK"), colors))
    np.testing.assert_allclose(scene.meshes[0].colors, colors[:, :3])
