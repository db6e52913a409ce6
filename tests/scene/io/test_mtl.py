"""Options of MTL's texture statements: where a texture is looked up."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import raystream as rs
from raystream.core.errors import RaystreamWarning
from raystream.rendering.color import decode_srgb
from raystream.scene.io.mtl import read_mtl
from raystream.scene.material import Material

ROLES = {
    "map_Kd": "diffuse",
    "map_Ks": "specular",
    "map_Ke": "emission",
    "map_d": "opacity",
    "map_Bump": "bump",
    "bump": "bump",
    "map_Kn": "normal",
    "norm": "normal",
    "map_Pr": "metallic_roughness",
    "map_Pm": "metallic_roughness",
}

TEXELS = np.random.default_rng(2).integers(0, 256, (2, 4, 3), dtype=np.uint8)

SQUARE = """mtllib a.mtl
v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1
usemtl x\nf 1/1 2/2 3/3 4/4
"""
ABOVE = rs.Camera((0.5, 0.5, 1), (0.5, 0.5, 0), fov=2 * np.degrees(np.arctan(0.5)))


def material(tmp_path: Path, statements: str) -> Material:
    Image.fromarray(TEXELS).save(tmp_path / "a b.png")
    Image.new("L", (1, 1), 9).save(tmp_path / "m.png")
    (tmp_path / "a.mtl").write_text(f"newmtl x\n{statements}\n")
    return read_mtl(tmp_path / "a.mtl")["x"]


@pytest.mark.parametrize("word", ROLES)
def test_every_map_has_its_own_scale_and_offset(tmp_path: Path, word: str) -> None:
    made = material(tmp_path, f"{word} -o .25 .5 -bm 1 -s 2 -3 1 -clamp on a b.png")
    texture = made.textures[ROLES[word]]
    assert (texture.name, texture.wrap) == ("a b.png", "clamp")
    assert texture.transform == (2, 0, 0.25, 0, -3, 0.5)


@pytest.mark.parametrize(
    ("options", "transform", "wrap"),
    [
        ("-s 2", (2, 0, 0, 0, 1, 0), "repeat"),
        ("-O -1 .5 7 -clamp ON", (1, 0, -1, 0, 1, 0.5), "clamp"),
        ("-s 1 1 1 -o 0 0 0 -clamp off", None, "repeat"),
        ("-s nan 2 -o inf", (1, 0, 0, 0, 2, 0), "repeat"),
        ("-s 1e99 -1e99", (1e30, 0, 0, 0, -1e30, 0), "repeat"),
        ("-s -o 3", (1, 0, 3, 0, 1, 0), "repeat"),
    ],
)
def test_options(
    tmp_path: Path, options: str, transform: tuple[float, ...] | None, wrap: str
) -> None:
    texture = material(tmp_path, f"map_Kd {options} a b.png").textures["diffuse"]
    assert (texture.name, texture.transform, texture.wrap) == ("a b.png", transform, wrap)


@pytest.mark.parametrize("mode", ["path", "whitted"])
def test_scaled_and_moved_texels(tmp_path: Path, mode: str) -> None:
    """Two copies across, four up; moved by a texel to the left, and by one down."""
    material(tmp_path, "Kd 0 0 0\nKe 1 1 1\nmap_Ke -s 2 4 -o .25 .5 a b.png")
    (tmp_path / "a.obj").write_text(SQUARE)
    scene = rs.load(tmp_path / "a.obj").replace(camera=ABOVE)
    found = rs.render(scene, mode, (8, 8), 1).pixels
    expected = np.roll(np.tile(decode_srgb(TEXELS), (4, 2, 1)), (1, -1), axis=(0, 1))
    np.testing.assert_allclose(found, expected, atol=2e-5)


def test_turbulence_warns_once(tmp_path: Path) -> None:
    statements = "map_Kd -t .1 a b.png\nmap_Ks -t 0 0 0 m.png\nbump -t 0 1 a b.png"
    with pytest.warns(RaystreamWarning, match=r"a\.mtl: the turbulence .*: 'a b\.png'$") as caught:
        made = material(tmp_path, statements)
    assert len(caught) == 1
    assert sorted(made.textures) == ["bump", "diffuse", "specular"]


def test_roughness_and_metal_have_one_scale(tmp_path: Path) -> None:
    both = material(tmp_path, "map_Pr -s 2 2 a b.png\nmap_Pm -s 2 2 1 m.png")
    assert both.textures["metallic_roughness"].transform == (2, 0, 0, 0, 2, 0)
    with pytest.warns(RaystreamWarning, match=r"map_Pm.* are shown with the -s.*: 'm\.png'$"):
        both = material(tmp_path, "map_Pr -s 2 2 a b.png\nmap_Pm m.png")
    assert both.textures["metallic_roughness"].transform == (2, 0, 0, 0, 2, 0)
