"""Denoisers: brightness and errors of images with few samples, before and after each filter.

    python benchmarks/denoisers.py
    python benchmarks/denoisers.py kitchen --samples 8 --keep images

Against a reference of 512 samples, in mode ``path``, prints the change of the mean luminance by the
filter in per cent, the root mean square error, the mean relative error, the peak signal-to-noise
ratio in decibels, and the seconds taken. ``--keep`` stores the images in a folder.
"""

import argparse
import time
from pathlib import Path

import numpy as np

import raystream as rs
from raystream.rendering.color import luminance
from raystream.rendering.oidn import has_oidn

REFERENCE_SAMPLES = 512


def brightness(image):
    """Mean luminance."""
    return float(luminance(image.pixels.astype(np.float64)).mean())


def timed(image, method):
    """The denoised image, and the seconds of a second run, since the first one compiles."""
    image.denoise(method)
    start = time.perf_counter()
    smooth = image.denoise(method)
    return smooth, time.perf_counter() - start


def main():
    parser = argparse.ArgumentParser()
    default = ["cornell", "building", "robots", "kitchen"]
    parser.add_argument("scenes", nargs="*", default=default)
    parser.add_argument("--samples", type=int, nargs="*", default=[8, 16])
    parser.add_argument("--size", type=int, nargs=2, default=[240, 180])
    parser.add_argument("--keep", type=Path)
    arguments = parser.parse_args()
    methods = ["atrous", "oidn"] if has_oidn() else ["atrous"]
    print("scene    samples filter    mean   RMSE    relative PSNR seconds")
    for name in arguments.scenes:
        tracer = rs.Tracer(rs.load(name))
        size = tuple(arguments.size)
        reference = rs.render(tracer, "path", size, REFERENCE_SAMPLES, seed=3)
        images = {"reference": reference}
        for seed, samples in enumerate(arguments.samples, start=1):
            noisy = rs.render(tracer, "path", size, samples, layers="all", seed=seed)
            rows = {"none": (noisy, 0.0)}
            rows |= {method: timed(noisy, method) for method in methods}
            for method, (image, seconds) in rows.items():
                images[f"{samples}_{method}"] = image
                error = image.compare(reference)
                change = 100.0 * (brightness(image) / brightness(noisy) - 1.0)
                print(
                    f"{name:8} {samples:7} {method:7} {change:+6.2f} {error.rmse:7.4f} "
                    f"{error.mean_relative_error:7.3f} {error.psnr:7.1f} {seconds:7.2f}",
                    flush=True,
                )
        if arguments.keep is not None:
            arguments.keep.mkdir(exist_ok=True)
            exposure = 0.7 / float(np.quantile(reference.pixels.max(axis=2), 0.9))
            for which, image in images.items():
                path = arguments.keep / f"{name}_{which}.png"
                image.save(path, exposure=exposure)


if __name__ == "__main__":
    main()
