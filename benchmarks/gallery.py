"""Pictures of six scenes in every mode: a sheet for each scene.

    python benchmarks/gallery.py -o docs/images

draws gallery_cornell.png, gallery_robots.png and so on; names of scenes draw only theirs. Models
that are not there (see `RAYSTREAM_SCENES`) are skipped. `--samples` says how many samples paths
get, before they are denoised. The other modes have little noise, and get an eighth of it.
"""

import argparse
import math
import time
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from rich.progress import Progress

import raystream as rs
from raystream.core.errors import RaystreamError

MODES = ("raycast", "vis", "shadow", "whitted", "xray", "ao", "kajiya", "path")

#: Modes that show light, and so are exposed for it.
EXPOSED = ("raycast", "shadow", "whitted", "kajiya", "path")

#: Pictures side by side.
COLUMNS = 4


def sky(zenith=(0.18, 0.36, 0.8), horizon=(0.75, 0.82, 0.9), ground=(0.2, 0.18, 0.16)):
    """A clear sky over even ground, as an image all around."""
    height = 128
    elevation = np.radians(90.0 - (np.arange(height) + 0.5) * 180.0 / height)
    share = np.clip(np.sin(elevation), 0.0, 1.0)[:, None] ** 0.5
    above = np.array(horizon) * (1.0 - share) + np.array(zenith) * share
    rows = np.where(elevation[:, None] > 0.0, above, ground)
    return rs.EnvironmentLight(image=np.repeat(rows[:, None], 2 * height, axis=1))


def lit(scene, sun, irradiance=(3.3, 3.0, 2.6), meshes=(), materials=None):
    """The same scene with a sun and a sky, and further meshes."""
    return rs.Scene(
        [*scene.meshes, *meshes],
        materials=materials or scene.materials,
        lights=[rs.DirectionalLight(sun, irradiance), sky()],
        camera=scene.camera,
        up=scene.up,
    )


def bunny():
    """The bunny on a floor, with a sun from the left."""
    scene = rs.load("bunny")
    low = float(scene.bounds[0, 1])
    reach = 20.0
    floor = rs.Mesh(
        [(x * reach, low, z * reach) for x, z in ((-1, -1), (-1, 1), (1, 1), (1, -1))],
        [[0, 1, 2], [0, 2, 3]],
        material_ids=1,
    )
    materials = [rs.Material(diffuse=(0.8, 0.7, 0.58)), rs.Material(diffuse=(0.42, 0.42, 0.4))]
    return lit(scene, (0.6, -0.8, -0.55), meshes=[floor], materials=materials)


def sponza():
    """The atrium, with a sun that stands high over its open roof."""
    return lit(rs.load("sponza"), (0.45, -1.0, 0.12), (6.0, 5.6, 5.0))


def helmet():
    """The helmet, with a sun behind who looks at it, to the left."""
    return lit(rs.load("helmet"), (-0.6, -0.7, 0.7))


SCENES = {
    "cornell": lambda: rs.load("cornell"),
    "bunny": bunny,
    "sponza": sponza,
    "kitchen": lambda: rs.load("kitchen"),
    "robots": lambda: rs.load("robots"),
    "helmet": helmet,
}

#: Options of modes in scenes: indoors rays of ambient occlusion end before walls, outdoors they do
#: not end; and caustics of small lights, dots for want of samples, are bounded.
OPTIONS = {
    **{(name, "ao"): {"distance": math.inf} for name in ("cornell", "bunny", "helmet", "robots")},
    ("sponza", "ao"): {"distance": 3.0},
    ("kitchen", "ao"): {"distance": 1.0},
    ("kitchen", "kajiya"): {"clamp": 4.0},
    ("kitchen", "path"): {"clamp": 4.0},
    ("robots", "kajiya"): {"clamp": 4.0},
    ("robots", "path"): {"clamp": 4.0},
}


#: Scenes whose paths are exposed so many times as much, with a curve that keeps what is bright.
BRIGHTER = {"sponza": 3.0}


def draw(tracer, name, mode, size, samples, progress):
    """The picture of a scene in a mode."""
    options = OPTIONS.get((name, mode), {})
    if mode not in ("path", "kajiya"):
        return rs.render(tracer, mode, size, max(samples // 8, 1), progress=progress, **options)
    image = rs.render(tracer, mode, size, samples, layers="all", progress=progress, **options)
    return image.denoise()


def exposure(image):
    """A factor that makes the brightest part of a picture, lights apart, nearly white."""
    level = float(np.quantile(image.pixels.max(axis=2), 0.98))
    return min(0.9 / level, 8.0) if level > 0.0 else 1.0


def tile(image, name, mode):
    """A picture as bytes, with the mode's name in a corner."""
    factor, tone = exposure(image) if mode in EXPOSED else 1.0, "linear"
    if name in BRIGHTER and mode in ("path", "kajiya"):
        factor, tone = factor * BRIGHTER[name], "reinhard"
    picture = Image.fromarray(image.to_bytes(factor, tone))
    draw = ImageDraw.Draw(picture)
    font = ImageFont.load_default(max(image.size[1] // 18, 8))
    place = image.size[1] // 40
    left, top, right, bottom = draw.textbbox((2 * place, 2 * place), mode, font)
    draw.rectangle((left - place, top - place, right + place, bottom + place), "black")
    draw.text((2 * place, 2 * place), mode, "white", font)
    return picture


def draw_sheet(tracer, name, modes, size, samples, progress):
    """All modes of a scene, in rows of `COLUMNS`."""
    width, height = size
    columns = min(COLUMNS, len(modes))
    sheet = Image.new("RGB", (columns * width, -(-len(modes) // columns) * height))
    for index, mode in enumerate(modes):
        task = progress.add_task(mode)

        def show(done, total, task=task):
            progress.update(task, completed=done, total=total)

        image = draw(tracer, name, mode, size, samples, show)
        place = index % columns * width, index // columns * height
        sheet.paste(tile(image, name, mode), place)
        progress.remove_task(task)
    return sheet


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("scenes", nargs="*", default=[], metavar="scene", help=", ".join(SCENES))
    parser.add_argument("-o", "--output", default="docs/images", help="a folder")
    parser.add_argument("--size", default="400x300", help="of a picture in a sheet")
    parser.add_argument("--samples", type=int, default=64)
    parser.add_argument("--modes", nargs="+", default=MODES, choices=MODES)
    arguments = parser.parse_args()
    unknown = [name for name in arguments.scenes if name not in SCENES]
    if unknown:
        parser.error(f"{unknown[0]}: expected one of {', '.join(SCENES)}")
    size = tuple(int(length) for length in arguments.size.split("x"))
    with Progress() as progress:
        for name in arguments.scenes or SCENES:
            began = time.perf_counter()
            try:
                tracer = rs.Tracer(SCENES[name]())
            except (RaystreamError, OSError) as error:
                progress.print(f"{name}: skipped: {error}")
                continue
            sheet = draw_sheet(tracer, name, arguments.modes, size, arguments.samples, progress)
            path = Path(arguments.output) / f"gallery_{name}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            sheet.save(path, optimize=True)
            seconds, size_kb = time.perf_counter() - began, path.stat().st_size / 1000
            progress.print(f"{path}: {seconds:.0f} seconds, {size_kb:.0f} kB")


if __name__ == "__main__":
    main()
