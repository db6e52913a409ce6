"""Path tracing here and with Mitsuba 3: the time per sample, and whether the images agree.

    python benchmarks/render_speed.py cornell sponza
    python benchmarks/render_speed.py --size 256 --samples 1024 --parts 16   # for the images

Renders scenes here and with Mitsuba (``pip install mitsuba``). Their surfaces are made matte, with
their colour textures, and scenes without light of their own are under a white sky. Mitsuba also
traces paths with light sampling, with Russian roulette from the same surface on, and to the same
depth: its ``max_depth`` counts a path's edges from the eye to the light, one more than the surfaces
between. Both spread their samples evenly over each pixel (a box filter), with independent numbers.
Each runs in its own process, since idle threads of one would take the other's cores. After a
warm-up part (compilation, memory), they take turns, each with a part of the samples; the ratio is
that of the medians.

Error is

    mean(|ours - theirs|) / mean(theirs)

over blocks of pixels and all channels. Its noise is the error that two correct images would have at
this number of samples, for which E|x| = sqrt(2 / pi) sigma. The last lines compare the variance of
a sample, averaged over the pixels: equal times at unequal noise would not be equal performance.

Mitsuba's compiled variants need an LLVM that can select ``minimum`` of floats: 15 and 16 abort
there, 19 and 22 do not. On Debian 12, use ``apt install libllvm19``; the newest installed version
is used, unless ``DRJIT_LIBLLVM_PATH`` names another. ``--variant scalar_rgb`` needs none. If a
renderer's process ends, so does the benchmark.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import multiprocessing
import statistics
import sys
import time
import warnings

import numpy as np
from render_stages import view_of

import raystream as rs
from raystream.bench.contender_process import how_it_ended
from raystream.rendering.color import decode_srgb


class Ours:
    """raystream's path tracer."""

    def __init__(self, scene, size, bounces, threads, _):
        rs.set_thread_count(threads)
        self.tracer, self.size, self.bounces = rs.Tracer(scene), size, bounces

    def render(self, samples, seed):
        """Pixels of shape (H, W, 3)."""
        options = {"seed": seed, "sampler": "random", "max_bounces": self.bounces}
        size = self.size, self.size
        return rs.render(self.tracer, "path", size, samples, **options).pixels


class Mitsuba:
    """Mitsuba's path tracer, with the same triangles, materials and camera."""

    def __init__(self, scene, size, bounces, threads, variant):
        import drjit
        import mitsuba

        mitsuba.set_variant(variant)
        drjit.set_thread_count(threads)
        self.render_scene = mitsuba.render
        made = {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": bounces + 1, "rr_depth": 4},
            "sensor": _sensor(mitsuba, scene.camera, size),
        }
        for light in scene.lights:
            radiance = {"type": "rgb", "value": light.radiance}
            made["sky"] = {"type": "constant", "radiance": radiance}
        bitmaps = {}
        for index, mesh in enumerate(scene.meshes):
            for material_id in np.unique(mesh.material_ids):
                faces = mesh.faces[mesh.material_ids == material_id]
                material = scene.materials[material_id]
                made[f"mesh_{index}_{material_id}"] = _mesh(mitsuba, mesh, faces, material, bitmaps)
        self.scene = mitsuba.load_dict(made)

    def render(self, samples, seed):
        """Pixels of shape (H, W, 3)."""
        return np.array(self.render_scene(self.scene, spp=samples, seed=seed))


def _sensor(mitsuba, camera, size):
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


def _reflectance(mitsuba, material, bitmaps):
    """A colour, or a bitmap multiplied by it."""
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


def _mesh(mitsuba, mesh, faces, material, bitmaps):
    reflectance = _reflectance(mitsuba, material, bitmaps)
    matte = {"type": "diffuse", "reflectance": reflectance}
    properties = mitsuba.Properties()
    properties["bsdf"] = mitsuba.load_dict({"type": "twosided", "bsdf": matte})
    if material.emits:
        radiance = {"type": "rgb", "value": material.emission}
        properties["emitter"] = mitsuba.load_dict({"type": "area", "radiance": radiance})
    # Only the vertices in use: a mesh of the file has those of all materials.
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
    """A scene with only diffuse surfaces, on both sides, with a light and a camera."""
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
    """The relative error expected from noise alone, from the spread of the parts."""
    spread = [np.var([in_blocks(part, side) for part in each], axis=0, ddof=1) for each in parts]
    variance = sum(s / len(each) for s, each in zip(spread, parts, strict=True))
    mean = np.mean([part.mean() for part in parts[1]])
    # The root of an estimated variance is too small by a relative 1 / (4 degrees of freedom).
    degrees = sum(len(each) - 1 for each in parts)
    sigma = np.sqrt(variance).mean() / (1 - 1 / (4 * degrees))
    return math.sqrt(2 / math.pi) * sigma / mean


def serve(pipe, kind, name, *options):
    """Render parts of a scene on request, and send pixels and seconds."""
    warnings.simplefilter("ignore")  # triangles without area
    renderer = kind(matte(name), *options)
    with contextlib.suppress(EOFError):  # the benchmark has ended
        while True:
            samples, seed = pipe.recv()
            started = time.perf_counter()
            pixels = renderer.render(samples, seed)
            taken = time.perf_counter() - started
            pipe.send((pixels.astype(np.float64), taken))


class Server:
    """A renderer of a scene in its own process; see `serve`."""

    def __init__(self, kind, *options):
        spawning = multiprocessing.get_context("spawn")
        self.kind = kind
        self.pipe, far = spawning.Pipe()
        self.process = spawning.Process(target=serve, args=(far, kind, *options), daemon=True)
        self.process.start()
        far.close()  # only the process holds it now, so the pipe closes when the process ends

    def render(self, samples, seed):
        """Pixels and seconds; if the process has ended, the benchmark ends too."""
        try:
            self.pipe.send((samples, seed))
            return self.pipe.recv()
        except (EOFError, OSError):
            self.process.join()
            sys.exit(f"{self.kind.__name__}: {how_it_ended(self.process.exitcode)}")

    def close(self):
        """End the process."""
        self.pipe.close()
        self.process.join()


def measure(name, arguments):
    """Render parts with both renderers in turn: two lists of pixels, two of seconds."""
    options = name, arguments.size, arguments.bounces, arguments.threads, arguments.variant
    servers = [Server(kind, *options) for kind in (Ours, Mitsuba)]
    samples = arguments.samples // arguments.parts
    parts, seconds = ([], []), ([], [])
    for seed in range(arguments.parts + 1):
        for server, pictures, times in zip(servers, parts, seconds, strict=True):
            pixels, taken = server.render(samples, seed)
            if seed:  # the first part warms up
                pictures.append(pixels)
                times.append(taken)
    for server in servers:
        server.close()
    return parts, seconds


def report(name, parts, seconds, arguments):
    """Print times and errors."""
    size, samples = arguments.size, arguments.samples // arguments.parts
    print(
        f"{name}, {size}x{size}, max_bounces={arguments.bounces}, {arguments.parts} parts of "
        f"{samples} samples, {arguments.threads} threads, Mitsuba's {arguments.variant}"
    )
    count = size * size * samples
    medians = [statistics.median(times) / count * 1e9 for times in seconds]
    ratios = [a / b for a, b in zip(*seconds, strict=True)]
    print(
        f"ns per sample: ours {medians[0]:.0f}, theirs {medians[1]:.0f}; ours / theirs "
        f"{medians[0] / medians[1]:.2f} ({min(ratios):.2f} to {max(ratios):.2f})"
    )
    ours, theirs = (np.mean(pictures, axis=0) for pictures in parts)
    print(f"{'blocks':>8s} {'error':>8s} {'of noise':>9s}")
    for side in (1, 4, 16, size):
        error = relative_error(in_blocks(ours, side), in_blocks(theirs, side))
        print(f"{side:>8d} {error:>8.3%} {expected_error(parts, side):>9.3%}")
    print(f"{'':>8s} {'red':>9s} {'green':>9s} {'blue':>9s} {'variance of a sample':>21s}")
    for whose, picture, pictures in (("ours", ours, parts[0]), ("theirs", theirs, parts[1])):
        variance = np.var(pictures, axis=0, ddof=1).mean() * samples
        print(
            f"{whose:>8s} "
            + " ".join(f"{value:>9.6f}" for value in picture.mean(axis=(0, 1)))
            + f" {variance:>21.5f}"
        )


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("scenes", nargs="*", default=["cornell"])
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--samples", type=int, default=112)
    parser.add_argument("--parts", type=int, default=7)
    parser.add_argument("--bounces", type=int, default=4)
    parser.add_argument("--variant", default="llvm_ad_rgb", help="Mitsuba's, or scalar_rgb")
    parser.add_argument("--threads", type=int, default=rs.thread_count())
    arguments = parser.parse_args()
    if arguments.parts < 2:
        parser.error("--parts: at least 2, for the noise")
    for name in arguments.scenes:
        report(name, *measure(name, arguments), arguments)


if __name__ == "__main__":
    main()
