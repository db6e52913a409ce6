"""The images of `same_bits`, some of them of model files that it writes."""

import base64
import json
import os
import tempfile
from functools import partial
from pathlib import Path

import bits_scenes as made
import numpy as np
from PIL import Image

import raystream as rs

MODES = ("vis", "raycast", "shadow", "whitted", "path", "xray", "ao", "kajiya")
THREE_MODES = ("raycast", "whitted", "path")
GLTF = ("BoxTextured.glb", "CesiumMilkTruck.glb", "CornellBox_bevy.glb")


def _write_textures(folder):
    """Colours, and the same with an alpha channel of holes."""
    rng = np.random.default_rng(6)
    pixels = rng.integers(0, 256, (16, 16, 4)).astype(np.uint8)
    pixels[..., 3] = np.where(rng.random((16, 16)) < 0.5, 255, 64)
    Image.fromarray(pixels[..., :3]).save(folder / "colors.png")
    Image.fromarray(pixels).save(folder / "holes.png")


#: Squares of both files: their centres, and what spans them.
SQUARES = {
    "floor": ([0, 0, 0], [8, 0, 0], [0, 0, -8]),
    "card": ([0, 2, 0], [2, 0, 0], [0, 2, 0]),
    "lamp": ([0, 7, 0], [1, 0, 0], [0, 0, 1]),
    "mirror": ([0, 4, -7], [6, 0, 0], [0, 4, 0]),
}
WEIGHTS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])

MTL = """newmtl floor
Kd 1 1 1
map_Kd colors.png
newmtl card
Kd 0.75 0.5 0.25
map_d holes.png
newmtl lamp
Kd 0 0 0
Ke 16 16 12
newmtl mirror
Kd 0.125 0.125 0.125
Ks 0.75 0.75 0.75
Ns 64
illum 3
"""


def _square(name):
    center, right, up = (np.array(one, float) for one in SQUARES[name])
    return center + WEIGHTS[:, :1] * right + WEIGHTS[:, 1:] * up


def obj_scene(folder):
    """Read an OBJ file with textured, masked, emissive and mirroring materials."""
    _write_textures(folder)
    lines = ["mtllib box.mtl", *(f"vt {u} {v}" for u, v in (WEIGHTS + 1) / 2)]
    for index, name in enumerate(SQUARES):
        lines += [f"v {x} {y} {z}" for x, y, z in _square(name)]
        corners = " ".join(f"{4 * index + k}/{k}" for k in range(1, 5))
        lines += [f"o {name}", f"usemtl {name}", f"f {corners}"]
    (folder / "box.mtl").write_text(MTL)
    (folder / "box.obj").write_text("\n".join(lines) + "\n")
    return rs.load(folder / "box.obj").replace(camera=rs.Camera((4, 5, 14), (0, 2, 0), fov=45))


def gltf_scene(folder):
    """Read a glTF file with textures, alpha masks, rough metal, and punctual lights."""
    _write_textures(folder)
    arrays = [np.array([[0, 1, 2], [0, 2, 3]], np.uint16), ((WEIGHTS + 1) / 2).astype(np.float32)]
    arrays += [_square(name).astype(np.float32) for name in SQUARES]
    kinds = [(5123, 6, "SCALAR"), (5126, 4, "VEC2"), *[(5126, 4, "VEC3")] * len(SQUARES)]
    lights = [
        {"type": "point", "intensity": 64, "color": [1, 0.75, 0.5]},
        {"type": "spot", "intensity": 256, "spot": {"innerConeAngle": 0.25, "outerConeAngle": 0.5}},
        {"type": "directional", "intensity": 0.5},
    ]
    places = [
        {"translation": [-3, 5, 3]},
        {"translation": [2, 4, 10]},
        {"rotation": [-0.6, 0, 0, 0.8]},
    ]
    materials = [
        {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "roughnessFactor": 0.5}},
        {
            "pbrMetallicRoughness": {"baseColorTexture": {"index": 1}, "metallicFactor": 0},
            "alphaMode": "MASK",
            "doubleSided": True,
        },
        {"emissiveFactor": [1, 1, 0.75]},
        {"pbrMetallicRoughness": {"metallicFactor": 1, "roughnessFactor": 0.25}},
    ]
    primitives = [
        {"attributes": {"POSITION": 2 + k, "TEXCOORD_0": 1}, "indices": 0, "material": k}
        for k in range(len(SQUARES))
    ]
    document = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": list(range(len(SQUARES) + 4))}],
        "nodes": [
            *({"mesh": k} for k in range(len(SQUARES))),
            *(
                {**place, "extensions": {"KHR_lights_punctual": {"light": k}}}
                for k, place in enumerate(places)
            ),
            {"translation": [0, 4, 16], "camera": 0},
        ],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 0.75, "znear": 0.125}}],
        "meshes": [{"primitives": [one]} for one in primitives],
        "materials": materials,
        "textures": [{"source": 0}, {"source": 1}],
        "images": [{"uri": "colors.png"}, {"uri": "holes.png"}],
        "extensionsUsed": ["KHR_lights_punctual"],
        "extensions": {"KHR_lights_punctual": {"lights": lights}},
        "accessors": [
            {"bufferView": k, "componentType": component, "count": count, "type": kind}
            for k, (component, count, kind) in enumerate(kinds)
        ],
        "bufferViews": [],
    }
    content = b""
    for array in arrays:
        view = {"buffer": 0, "byteOffset": len(content), "byteLength": array.nbytes}
        document["bufferViews"].append(view)
        content += array.tobytes()
    uri = "data:;base64," + base64.b64encode(content).decode()
    document["buffers"] = [{"byteLength": len(content), "uri": uri}]
    (folder / "box.gltf").write_text(json.dumps(document))
    return rs.load(folder / "box.gltf")


def image_answers(scene, modes, samples, layers=None):
    """Yield images in several modes."""
    tracer = rs.Tracer(scene)
    for mode in modes:
        image = rs.render(tracer, mode, (96, 72), samples=samples, layers=layers)
        yield mode, [image.pixels, *(image.layers[name] for name in sorted(image.layers))]


def images(_count):
    """Images: textured, masked and lit, of every kind of scene that renderers support."""
    for name in ("cornell", "spheres"):
        yield f"images: {name}", partial(image_answers, rs.load(name), MODES, 2)
    for name in ("blocks", "instances", "mixed"):
        scene = getattr(made, name)()
        yield f"images: {name}", partial(image_answers, scene, THREE_MODES, 2)
    for name, read in (("obj", obj_scene), ("gltf", gltf_scene)):
        with tempfile.TemporaryDirectory() as folder:
            scene = read(Path(folder))
            yield f"images: {name}", partial(image_answers, scene, THREE_MODES, 4, "all")
            sky = np.random.default_rng(18).integers(0, 256, (8, 16, 3)) / 64.0
            scene = scene.replace(lights=[rs.EnvironmentLight(image=sky)])
            yield f"images: {name} and sky", partial(image_answers, scene, THREE_MODES, 4)
    folder = os.environ.get("RAYSTREAM_SCENES")
    for name in GLTF:
        path = Path(folder or "", "gltf", name)
        if folder and path.exists():
            yield f"images: {name}", partial(image_answers, rs.load(path), THREE_MODES, 2)
        else:
            yield f"images: {name}", None
