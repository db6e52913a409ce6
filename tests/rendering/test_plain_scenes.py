"""Plain copies of shading kernels: the same bits as the kernels that shade every scene."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from raystream.cli.compiling import render_task
from raystream.jit.fingerprint import fingerprint
from raystream.rendering import path, raycast, whitted
from raystream.rendering.shading import local_shading, paths
from raystream.rendering.shading import whitted as whitted_shading
from raystream.rendering.shading.plain_scenes import kernel_for
from rendering.test_metal import floor

KERNELS = [
    (paths.shade_paths, paths.shade_plain_paths),
    (local_shading.shade_unshadowed, local_shading.shade_plain_unshadowed),
    (whitted_shading.shade_whitted, whitted_shading.shade_plain_whitted),
]

TEXTURE = rs.Texture(np.full((1, 1, 3), 99, np.uint8))
SKY = np.full((4, 8, 3), 0.5, np.float32)

SCENES = {
    "plain": (rs.Material(specular=(0.2, 0.2, 0.2), shininess=9), (), True),
    "glass": (rs.Material(transmission=(1, 1, 1), ior=1.5), (), True),
    "textured": (rs.Material(textures={"diffuse": TEXTURE}), (), False),
    "bumpy": (rs.Material(textures={"bump": TEXTURE}), (), False),
    "rough": (rs.Material(roughness=0.5, metallic=0.5), (), False),
    "coated": (rs.Material(roughness=0.5, metallic=0.5, clearcoat=1.0), (), False),
    "under a sky": (rs.Material(), (rs.EnvironmentLight(image=SKY),), False),
}


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("module", [path, raycast, whitted])
def test_which_kernel_shades(name, module, monkeypatch):
    material, lights, is_plain = SCENES[name]
    chosen = []

    def spy(*arguments):
        chosen.append(kernel_for(*arguments))
        return chosen[-1]

    monkeypatch.setattr(module, "kernel_for", spy)
    sun = rs.DirectionalLight((-0.3, -1, 0.2))
    mode = module.__name__.rpartition(".")[2]
    scene = floor(material, [sun, *lights], np.zeros((4, 2)))
    rs.render(scene, mode, (8, 8))
    assert {kernel in [plain for _, plain in KERNELS] for kernel in chosen} == {is_plain}
    # The command line compiles the same one in advance.
    assert render_task(mode, scene) == f"render-{mode}" + ("" if is_plain else ":full")


def room_of_glass():
    """The Cornell box; its tall block is of glass, and the other one shines."""
    scene = rs.load("cornell")
    glass = rs.Material(diffuse=(0, 0, 0), transmission=(1, 1, 1), ior=1.5, absorption=(1, 0, 0))
    glossy = rs.Material(specular=(0.3, 0.3, 0.3), shininess=20)
    materials = [*scene.materials, glass, glossy]
    meshes = [
        rs.Mesh(mesh.vertices, mesh.faces, material_ids=len(materials) - 1 - k % 2)
        if "block" in mesh.name
        else mesh
        for k, mesh in enumerate(scene.meshes)
    ]
    assert len({id(mesh) for mesh in meshes} - {id(mesh) for mesh in scene.meshes}) == 2
    return scene.replace(meshes=meshes, materials=materials)


@pytest.mark.parametrize("mode", ["path", "kajiya", "raycast", "shadow", "whitted"])
@pytest.mark.parametrize("name", ["cornell_mirrors", "robots:20000", "room of glass"])
def test_plain_copies_give_the_same_bits(name, mode, monkeypatch):
    tracer = rs.Tracer(room_of_glass() if name == "room of glass" else rs.load(name))
    used = set()

    def spy(*arguments):
        used.add(kernel_for(*arguments))
        return next(iter(used))

    for module in (path, raycast, whitted):
        monkeypatch.setattr(module, "kernel_for", spy)
    plain = rs.render(tracer, mode, (48, 32), 2)
    assert used < {copy for _, copy in KERNELS}
    for module in (path, raycast, whitted):
        monkeypatch.setattr(module, "kernel_for", lambda shading, *_: shading)
    full = rs.render(tracer, mode, (48, 32), 2)
    np.testing.assert_array_equal(plain.pixels, full.pixels)
    assert plain.pixels.max() > 0.1


@pytest.mark.parametrize(("shading", "of_plain_scenes"), KERNELS)
def test_plain_copies_are_cached_apart(shading, of_plain_scenes):
    names = {one.py_func.__qualname__ for one in (shading, of_plain_scenes)}
    hashes = {fingerprint(one) for one in (shading, of_plain_scenes)}
    assert len(names) == len(hashes) == 2
    assert None not in hashes
