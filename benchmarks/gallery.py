"""Pictures of scenes in every mode, side by side.

    python benchmarks/gallery.py robots cornell -o docs/images/modes.png

The modes of a scene follow each other in rows of four. `--samples` says how many samples paths
get: with 64 or more they are smooth. (ao gets an eighth of it, the others a sixteenth.)
"""

import argparse

import numpy as np

import raystream as rs
from raystream.render.tone import apply_tone

MODES = ("raycast", "vis", "shadow", "whitted", "xray", "ao", "kajiya", "path")

#: Pictures side by side.
COLUMNS = 4


def samples_of(mode, samples):
    """Samples of a pixel in a mode."""
    if mode in ("path", "kajiya"):
        return samples
    return max(samples // (8 if mode == "ao" else 16), 1)


def brightness(image):
    """An exposure that makes the brightest part of a picture, lights apart, nearly white."""
    level = float(np.quantile(image.pixels.max(axis=2), 0.98))
    return 0.9 / level if level > 0.0 else 1.0


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("-o", "--output", required=True)
    parser.add_argument("--size", default="240x180")
    parser.add_argument("--samples", type=int, default=64)
    parser.add_argument("--modes", nargs="+", default=MODES, choices=MODES)
    arguments = parser.parse_args()
    width, height = (int(length) for length in arguments.size.split("x"))
    rows = []
    for name in arguments.scenes:
        tracer = rs.Tracer(rs.load(name))
        pictures = []
        for mode in arguments.modes:
            samples = samples_of(mode, arguments.samples)
            image = rs.render(tracer, mode, (width, height), samples)
            exposure = min(brightness(image), 8.0) if mode in ("kajiya", "path") else 1.0
            pictures.append(image.pixels * np.float32(exposure))
            print(name, mode, f"{samples} samples", flush=True)
        while len(pictures) % COLUMNS:
            pictures.append(np.zeros_like(pictures[0]))
        rows += [
            np.concatenate(pictures[first : first + COLUMNS], axis=1)
            for first in range(0, len(pictures), COLUMNS)
        ]
    sheet = apply_tone(np.concatenate(rows, axis=0), "linear")
    rs.Image(np.minimum(sheet, 1.0)).save(arguments.output)


if __name__ == "__main__":
    main()
