"""Textures' coordinates and extensions of materials in glTF."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from raystream.core.errors import FileFormatError, RaystreamWarning
from raystream.scene.material import Material
from raystream.scene.scene import Scene
from scene.io import tiny
from scene.io.test_gltf import read
from scene.io.tiny import with_buffer

FIRST = np.array([[0, 0], [1, 0], [0, 1], [0.25, 0.75]], np.float32)
SECOND = np.array([[0.5, 0.5], [1, 0], [0.125, 1], [0, 0.25]], np.float32)


def textured(material: dict[str, Any]) -> dict[str, Any]:
    """The tetrahedron with two sets of texture coordinates, and images 0 to 3."""
    document = with_buffer(tiny.gltf_document(), tiny.TETRAHEDRON, tiny.SIDES, FIRST, SECOND)
    pairs = {"componentType": 5126, "count": 4, "type": "VEC2"}
    document["accessors"] = [
        {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
        {"bufferView": 1, "componentType": 5125, "count": 12, "type": "SCALAR"},
        {"bufferView": 2, **pairs},
        {"bufferView": 3, **pairs},
    ]
    document["meshes"][0]["primitives"][0] |= {
        "attributes": {"POSITION": 0, "TEXCOORD_0": 2, "TEXCOORD_1": 3},
        "material": 0,
    }
    document["materials"] = [material]
    document["textures"] = [{"source": k} for k in range(4)]
    document["images"] = [{"uri": f"{k}.png"} for k in range(4)]
    return document


def loaded(tmp_path: Path, material: dict[str, Any]) -> tuple[Scene, Material]:
    for k in range(4):
        Image.new("RGBA", (2, 2), (k, 0, 0, 9)).save(tmp_path / f"{k}.png")
    scene = read(tmp_path, textured(material))
    return scene, scene.materials[0]


def moved(texcoords: np.ndarray[Any, Any], **transform: Any) -> np.ndarray[Any, Any]:
    """The extension's formula, with the rotation of its text; v downward before and after."""
    angle, offset = transform.get("rotation", 0.0), transform.get("offset", [0, 0])
    c, s = math.cos(angle), math.sin(angle)
    turn = np.array([[c, s], [-s, c]])  # from +u towards -v, which is up in the image
    scale = np.array(transform.get("scale", [1, 1]))
    return (texcoords * scale) @ turn.T + np.array(offset)


def upward(texcoords: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    return np.column_stack([texcoords[:, 0], 1 - texcoords[:, 1]])


def use(index: int, texcoord: int | None = None, **transform: Any) -> dict[str, Any]:
    entry: dict[str, Any] = {"index": index}
    if transform:
        entry["extensions"] = {"KHR_texture_transform": transform}
    return entry if texcoord is None else entry | {"texCoord": texcoord}


TURNED: dict[str, Any] = {"offset": [0.5, -0.25], "rotation": 0.3, "scale": [2, 3]}


def test_a_transform_that_textures_share_is_in_the_mesh(tmp_path: Path) -> None:
    surface = {"baseColorTexture": use(0, **TURNED), "metallicRoughnessTexture": use(1, **TURNED)}
    scene, material = loaded(tmp_path, {"pbrMetallicRoughness": surface})
    np.testing.assert_allclose(scene.meshes[0].texcoords, upward(moved(FIRST, **TURNED)), atol=1e-6)
    assert [texture.transform for texture in material.textures.values()] == [None, None]


def test_the_example_of_the_extension(tmp_path: Path) -> None:
    """The lower left quadrant of the image, turned clockwise by 90 degrees."""
    transform = {"offset": [0, 1], "rotation": math.pi / 2, "scale": [0.5, 0.5]}
    surface = {"baseColorTexture": use(0, **transform)}
    scene, _ = loaded(tmp_path, {"pbrMetallicRoughness": surface})
    found = scene.meshes[0].texcoords
    assert found is not None
    # Upper left, upper right, and lower left corner of the mesh; v upward.
    np.testing.assert_allclose(found[:3], [[0, 0], [0, 0.5], [0.5, 0]], atol=1e-6)


@pytest.mark.parametrize(
    "entry", [use(0, 1), use(0, 0, texCoord=1), use(0, texCoord=1, offset=[0, 0])]
)
def test_the_second_set(tmp_path: Path, entry: dict[str, Any]) -> None:
    scene, _ = loaded(tmp_path, {"pbrMetallicRoughness": {"baseColorTexture": entry}})
    np.testing.assert_array_equal(scene.meshes[0].texcoords, upward(SECOND))


def test_textures_with_transforms_of_their_own(tmp_path: Path) -> None:
    """The mesh has the normal map's coordinates; the others are looked up from there."""
    other = {"offset": [-1, 0.5], "rotation": -2.0, "scale": [0.5, -4]}
    surface = {"baseColorTexture": use(0, **other), "metallicRoughnessTexture": use(2)}
    document = {
        "pbrMetallicRoughness": surface,
        "normalTexture": use(1, **TURNED),
        "emissiveTexture": use(3, **TURNED),
        "alphaMode": "BLEND",
    }
    scene, material = loaded(tmp_path, document)
    of_mesh = scene.meshes[0].texcoords
    assert of_mesh is not None
    np.testing.assert_allclose(of_mesh, upward(moved(FIRST, **TURNED)), atol=1e-6)
    assert material.textures["normal"].transform is None
    assert material.textures["emission"].transform is None
    assert material.textures["opacity"].transform == material.textures["diffuse"].transform
    for role, transform in (("diffuse", other), ("metallic_roughness", {})):
        a, b, c, d, e, f = material.textures[role].transform or ()
        u, v = of_mesh.T
        found = np.column_stack([a * u + b * v + c, d * u + e * v + f])
        np.testing.assert_allclose(found, upward(moved(FIRST, **transform)), atol=1e-5)


def test_a_texture_of_another_set_is_left_out(tmp_path: Path) -> None:
    surface = {"baseColorTexture": use(0), "metallicRoughnessTexture": use(1)}
    document = {
        "pbrMetallicRoughness": surface,
        "emissiveTexture": use(2, 1),
        "occlusionTexture": use(3, 1),  # which no renderer uses
    }
    with pytest.warns(RaystreamWarning, match="left out: 1 for emission, with") as caught:
        scene, material = loaded(tmp_path, document)
    assert len(caught) == 1
    assert sorted(material.textures) == ["diffuse", "metallic_roughness"]
    np.testing.assert_array_equal(scene.meshes[0].texcoords, upward(FIRST))


def test_a_transform_to_one_point(tmp_path: Path) -> None:
    surface = {"baseColorTexture": use(0, scale=[0, 0], offset=[0.25, 0.5])}
    scene, material = loaded(tmp_path, {"pbrMetallicRoughness": surface})
    np.testing.assert_array_equal(scene.meshes[0].texcoords, upward(FIRST))
    assert material.textures["diffuse"].transform == pytest.approx((0, 0, 0.25, 0, 0, 0.5))


@pytest.mark.parametrize(
    ("transform", "reason"),
    [
        ({"offset": [1]}, "list of 2 numbers"),
        ({"scale": [1, "x"]}, "not a number"),
        ({"scale": [1, 1e300]}, "huge"),
        ({"rotation": 1e999}, "not a finite number"),
        ({"texCoord": -1}, "integer >= 0"),
    ],
)
def test_damaged_transforms(tmp_path: Path, transform: dict[str, Any], reason: str) -> None:
    with pytest.raises(FileFormatError, match=reason):
        loaded(tmp_path, {"pbrMetallicRoughness": {"baseColorTexture": use(0, **transform)}})


def extended(**extensions: dict[str, Any]) -> dict[str, Any]:
    return {"extensions": {f"KHR_materials_{name}": value for name, value in extensions.items()}}


def test_reflectance_of_ior_and_specular(tmp_path: Path) -> None:
    """F0 = ((n - 1) / (n + 1))^2 color, at most 1, times the factor; F90 is the factor."""
    color = {"specularFactor": 0.5, "specularColorFactor": [1, 0.5, 40]}
    _, material = loaded(tmp_path, extended(ior={"ior": 2}, specular=color))
    assert material.normal_reflectance == pytest.approx((0.5 / 9, 0.25 / 9, 0.5))
    assert material.grazing_reflectance == 0.5
    _, plain = loaded(tmp_path, {})
    assert plain.normal_reflectance == pytest.approx((0.04,) * 3)
    assert plain.grazing_reflectance == 1.0
    _, old = loaded(tmp_path, extended(ior={"ior": 0}))  # as in the specular-glossiness model
    assert old.normal_reflectance == (1, 1, 1)


def test_solid_glass_reflects_by_its_index(tmp_path: Path) -> None:
    glass = {"transmission": {"transmissionFactor": 0.75}, "volume": {"thicknessFactor": 1}}
    _, solid = loaded(tmp_path, extended(**glass, ior={"ior": 1.25}))
    assert (solid.ior, solid.grazing_reflectance) == (1.25, 0.25)
    assert solid.normal_reflectance == pytest.approx((0.25 / 81,) * 3)
    _, pane = loaded(tmp_path, extended(transmission=glass["transmission"], ior={"ior": 1.25}))
    assert (pane.ior, pane.grazing_reflectance) == (1.0, 1.0)
    assert pane.normal_reflectance == pytest.approx((1 / 81,) * 3)


def test_unlit_surfaces_emit_their_colour(tmp_path: Path) -> None:
    surface = {"baseColorFactor": [0.1, 0.2, 0.3, 0.5], "baseColorTexture": use(0)}
    document = {"pbrMetallicRoughness": surface, "normalTexture": use(1), "alphaMode": "BLEND"}
    _, material = loaded(tmp_path, document | extended(unlit={}))
    assert (material.emission, material.diffuse) == ((0.1, 0.2, 0.3), (0, 0, 0))
    assert (material.roughness, material.opacity) == (None, 0.5)
    assert sorted(material.textures) == ["emission", "opacity"]
    assert material.textures["opacity"].pixels()[0, 0, 0] == 9


def test_textures_of_extensions(tmp_path: Path) -> None:
    document = extended(
        transmission={"transmissionFactor": 0.5, "transmissionTexture": use(2)},
        specular={"specularTexture": use(1), "specularColorTexture": use(3)},
    )
    _, material = loaded(tmp_path, document)
    found = {role: texture.pixels()[0, 0].tolist() for role, texture in material.textures.items()}
    assert found == {"specular": [3, 0, 0, 9], "transmission": [2, 0, 0, 9], "reflectance": [9]}
    solid = document["extensions"] | extended(volume={"thicknessFactor": 1})["extensions"]
    expected = "left out: 1 for the specular factor of solids with a transmission map"
    with pytest.warns(RaystreamWarning, match=expected) as caught:
        _, material = loaded(tmp_path, {"extensions": solid})
    assert len(caught) == 1
    assert material.textures["reflectance"].pixels()[0, 0].tolist() == [255 - 1]
    assert (material.ior, material.grazing_reflectance) == (1.5, 1.0)


def test_clear_coats_and_sheen(tmp_path: Path) -> None:
    document = extended(
        clearcoat={
            "clearcoatFactor": 0.5,
            "clearcoatTexture": use(0),
            "clearcoatRoughnessFactor": 0.25,
            "clearcoatRoughnessTexture": use(1),
            "clearcoatNormalTexture": use(2) | {"scale": -0.75},
        },
        sheen={
            "sheenColorFactor": [0.1, 0.2, 0.3],
            "sheenColorTexture": use(3),
            "sheenRoughnessFactor": 0.125,
            "sheenRoughnessTexture": use(3),
        },
    )
    _, material = loaded(tmp_path, document)
    assert (material.clearcoat, material.clearcoat_roughness) == (0.5, 0.25)
    assert material.clearcoat_normal_scale == -0.75
    assert (material.sheen_color, material.sheen_roughness) == ((0.1, 0.2, 0.3), 0.125)
    found = {role: texture.pixels()[0, 0].tolist() for role, texture in material.textures.items()}
    assert found == {
        "clearcoat": [0, 0, 0, 9],
        "clearcoat_roughness": [1, 0, 0, 9],
        "clearcoat_normal": [2, 0, 0, 9],
        "sheen_color": [3, 0, 0, 9],
        "sheen_roughness": [9],
    }
    _, plain = loaded(tmp_path, {})
    assert (plain.is_coated, plain.has_sheen) == (False, False)
    _, extreme = loaded(tmp_path, extended(clearcoat={"clearcoatFactor": 7}, sheen={}))
    assert (extreme.clearcoat, extreme.clearcoat_roughness, extreme.has_sheen) == (1, 0, False)
