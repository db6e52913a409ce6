"""A scene by two path tracers: do they agree, and what does a sample take?

    python benchmarks/render_accuracy.py --samples 1024 --bounces 4
    python benchmarks/render_accuracy.py sponza.obj.gz --samples 256 --parts 8

Renders the Cornell box, or another scene whose surfaces are made matte, with their textures of
colour and, where it has no light of its own, under a white sky; here and with Mitsuba 3 (``pip
install mitsuba``), which traces paths with samples of the lights too, to the same depth:
Mitsuba's ``max_depth`` counts a path's edges from the eye to the light, one more than the
surfaces between. Both spread their samples evenly over each pixel (a box filter), with
independent numbers, and take turns, a part of the samples each. Error is

    mean(|ours - theirs|) / mean(theirs)

over blocks of pixels and all channels; so is its noise, what two pictures without any fault
would differ by at this number of samples, for which E|x| = sqrt(2 / pi) sigma. Mitsuba's
compiled variants need an LLVM that selects ``minimum`` of floats (15 stops there, 22 does
not): ``DRJIT_LIBLLVM_PATH`` names it; ``--variant scalar_rgb`` needs none.
"""

import argparse
import math
import statistics
import time

import drjit
import mitsuba
import numpy as np
from render_speed import view_of

import raystream as rs
from raystream.rendering.color import decode_srgb


class Ours:
    """raystream's path tracer."""

    def __init__(self, scene, size, bounces):
        self.tracer, self.size, self.bounces = rs.Tracer(scene), size, bounces

    def render(self, samples, seed):
        """Pixels of shape (H, W, 3)."""
        options = {"seed": seed, "sampler": "random", "max_bounces": self.bounces}
        size = self.size, self.size
        return rs.render(self.tracer, "path", size, samples, **options).pixels


class Mitsuba:
    """Mitsuba's, of the same triangles, materials and camera."""

    def __init__(self, scene, size, bounces):
        made = {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": bounces + 1, "rr_depth": 4},
            "sensor": _sensor(scene.camera, size),
        }
        for light in scene.lights:
            radiance = {"type": "rgb", "value": light.radiance}
            made["sky"] = {"type": "constant", "radiance": radiance}
        bitmaps = {}
        for index, mesh in enumerate(scene.meshes):
            for material_id in np.unique(mesh.material_ids):
                faces = mesh.faces[mesh.material_ids == material_id]
                material = scene.materials[material_id]
                made[f"mesh_{index}_{material_id}"] = _mesh(mesh, faces, material, bitmaps)
        self.scene = mitsuba.load_dict(made)

    def render(self, samples, seed):
        """Pixels of shape (H, W, 3)."""
        return np.array(mitsuba.render(self.scene, spp=samples, seed=seed))


def _sensor(camera, size):
    look = mitsuba.ScalarTransform4f().look_at(camera.eye, camera.look_at, camera.up)
    film = {
        "type": "hdrfilm",
        "width": size,
        "height": size,
        "pixel_format": "rgb",
        "component_format": "float32",
        "rfilter": {"type": "box"},
    }
    return {
        "type": "perspective",
        "fov": camera.fov,
        "fov_axis": "y",
        "near_clip": 1e-2,
        "far_clip": 1e5,
        "to_world": look,
        "film": film,
        "sampler": {"type": "independent"},
    }


def _reflectance(material, bitmaps):
    """A colour, or a bitmap times it."""
    texture = material.textures.get("diffuse")
    if texture is None:
        return {"type": "rgb", "value": material.diffuse}
    key = id(texture), material.diffuse
    if key not in bitmaps:
        pixels = texture.pixels()
        pixels = np.repeat(pixels, 3, axis=2) if pixels.shape[2] == 1 else pixels[:, :, :3]
        light = decode_srgb(np.ascontiguousarray(pixels)) * np.float32(material.diffuse)
        bitmaps[key] = mitsuba.Bitmap(light)
    return {"type": "bitmap", "bitmap": bitmaps[key], "raw": True, "wrap_mode": texture.wrap}


def _mesh(mesh, faces, material, bitmaps):
    reflectance = _reflectance(material, bitmaps)
    matte = {"type": "diffuse", "reflectance": reflectance}
    properties = mitsuba.Properties()
    properties["bsdf"] = mitsuba.load_dict({"type": "twosided", "bsdf": matte})
    if material.emits:
        radiance = {"type": "rgb", "value": material.emission}
        properties["emitter"] = mitsuba.load_dict({"type": "area", "radiance": radiance})
    # Only its own vertices: a mesh of the file has those of all materials.
    used, places = np.unique(faces, return_inverse=True)
    has_texture = reflectance["type"] == "bitmap" and mesh.texcoords is not None
    made = mitsuba.Mesh(
        "mesh", len(used), len(faces), props=properties, has_vertex_texcoords=has_texture
    )
    parameters = mitsuba.traverse(made)
    parameters["vertex_positions"] = np.asarray(mesh.vertices[used], np.float32).ravel()
    parameters["faces"] = places.astype(np.uint32).ravel()
    if has_texture:
        upward = mesh.texcoords[used] * [1, -1] + [0, 1]
        parameters["vertex_texcoords"] = upward.astype(np.float32).ravel()
    parameters.update()
    return made


def matte(name):
    """A scene whose surfaces only scatter evenly, on both sides, with a light and a camera."""
    scene = rs.load(name)
    materials = [
        rs.Material(
            diffuse=material.diffuse,
            emission=material.emission,
            textures={k: t for k, t in material.textures.items() if k == "diffuse"},
        )
        for material in scene.materials
    ]
    meshes = [
        rs.Mesh(m.vertices, m.faces, texcoords=m.texcoords, material_ids=m.material_ids)
        for m in scene.meshes
    ]
    lit = any(material.emits for material in materials)
    lights = [] if lit else [rs.EnvironmentLight((1.0, 1.0, 1.0))]
    camera = view_of(name, scene, 1.0)
    return rs.Scene(meshes, materials=materials, lights=lights, camera=camera)


def in_blocks(pixels, side):
    """Means over blocks of side x side pixels: shape (H / side, W / side, 3)."""
    height, width, _ = pixels.shape
    return pixels.reshape(height // side, side, width // side, side, 3).mean(axis=(1, 3))


def relative_error(ours, theirs):
    """mean(|ours - theirs|) / mean(theirs)."""
    return np.abs(ours - theirs).mean() / theirs.mean()


def expected_error(parts, side):
    """The relative error that noise alone would bring, from the spread of parts."""
    spread = [np.var([in_blocks(part, side) for part in each], axis=0, ddof=1) for each in parts]
    variance = sum(s / len(each) for s, each in zip(spread, parts, strict=True))
    mean = np.mean([part.mean() for part in parts[1]])
    # The root of an estimated variance is too small by 1 / (4 degrees of freedom).
    degrees = sum(len(each) - 1 for each in parts)
    sigma = np.sqrt(variance).mean() / (1 - 1 / (4 * degrees))
    return math.sqrt(2 / math.pi) * sigma / mean


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("scene", nargs="?", default="cornell")
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--samples", type=int, default=1024)
    parser.add_argument("--parts", type=int, default=16)
    parser.add_argument("--bounces", type=int, default=4)
    parser.add_argument("--variant", default="llvm_ad_rgb", help="of Mitsuba, or scalar_rgb")
    parser.add_argument("--threads", type=int, default=rs.thread_count())
    arguments = parser.parse_args()
    rs.set_thread_count(arguments.threads)
    mitsuba.set_variant(arguments.variant)
    drjit.set_thread_count(arguments.threads)

    scene = matte(arguments.scene)
    samples = arguments.samples // arguments.parts
    renderers = [make(scene, arguments.size, arguments.bounces) for make in (Ours, Mitsuba)]
    for renderer in renderers:  # compile
        renderer.render(samples, seed=0)
    parts, seconds = ([], []), ([], [])
    for seed in range(1, arguments.parts + 1):
        for renderer, pictures, times in zip(renderers, parts, seconds, strict=True):
            started = time.perf_counter()
            pictures.append(renderer.render(samples, seed).astype(np.float64))
            times.append(time.perf_counter() - started)

    ours, theirs = (np.mean(pictures, axis=0) for pictures in parts)
    size, threads = arguments.size, arguments.threads
    print(
        f"{arguments.scene}, {size}x{size}, max_bounces={arguments.bounces}, "
        f"{arguments.parts} parts of {samples} samples, {threads} threads, "
        f"mitsuba {mitsuba.__version__} {arguments.variant}"
    )
    print(f"{'blocks':>8s} {'error':>8s} {'of noise':>9s}")
    for side in (1, 4, 16, size):
        error = relative_error(in_blocks(ours, side), in_blocks(theirs, side))
        print(f"{side:>8d} {error:>8.3%} {expected_error(parts, side):>9.3%}")
    print(f"{'mean':>8s} {'red':>9s} {'green':>9s} {'blue':>9s}")
    for name, picture in (("ours", ours), ("theirs", theirs)):
        print(f"{name:>8s} " + " ".join(f"{value:>9.6f}" for value in picture.mean(axis=(0, 1))))
    count = size * size * samples
    medians = [statistics.median(times) / count * 1e9 for times in seconds]
    ratios = [a / b for a, b in zip(*seconds, strict=True)]
    print(f"ns per sample: ours {medians[0]:.0f}, theirs {medians[1]:.0f}")
    print(
        f"ours / theirs: median {statistics.median(ratios):.2f}, "
        f"{min(ratios):.2f} to {max(ratios):.2f}"
    )


if __name__ == "__main__":
    main()
