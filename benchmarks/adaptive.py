"""Adaptive sampling against uniform sampling, in equal processor time.

    python benchmarks/adaptive.py
    python benchmarks/adaptive.py cornell --seconds 6 --seeds 9

For each seed, renders an image with a time limit, sampled adaptively, then one with as many samples
per pixel as take about the same time. Errors are measured against a reference of 1,024 samples, and
scaled to equal time, since an error falls with the root of the time. Prints medians of the ratios
over the seeds; below 1, adaptive sampling is better.
"""

import argparse
import statistics
import time

import numpy as np

import raystream as rs

REFERENCE_SAMPLES = 1024

#: Measures, all of linear RGB: the mean relative and mean absolute errors, and the root mean
#: square errors of light up to 1 and of all light.
MEASURES = {
    "relative": lambda a, b: (np.abs(a - b) / (b + 0.01)).mean(),
    "absolute": lambda a, b: np.abs(a - b).mean(),
    "square, to 1": lambda a, b: np.sqrt(((np.minimum(a, 1) - np.minimum(b, 1)) ** 2).mean()),
    "square, all": lambda a, b: np.sqrt(((a - b) ** 2).mean()),
}


def rendered(tracer, size, **options):
    """Render an image, and measure the processor time of all threads, in seconds."""
    started = time.process_time()
    image = rs.render(tracer, "path", size, **options)
    return image, time.process_time() - started


def ratios(tracer, size, seconds, seed, reference):
    """Adaptive over uniform sampling: samples per second, then the error of each measure."""
    adaptive, took = rendered(tracer, size, time_limit=seconds, seed=seed)
    _, some = rendered(tracer, size, samples=16, seed=seed)
    samples = max(1, round(16 * took / some))
    even, took_even = rendered(tracer, size, samples=samples, seed=seed)
    yield adaptive.figures["samples"] / took / (samples / took_even)
    for measure in MEASURES.values():
        one, other = (measure(image.pixels, reference) for image in (adaptive, even))
        yield one / other * (took / took_even) ** 0.5


def main():
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    default = ["cornell", "sponza", "building", "kitchen"]
    parser.add_argument("scenes", nargs="*", default=default)
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--size", default="480x360")
    options = parser.parse_args()
    size = tuple(map(int, options.size.split("x")))
    print("scene    samples/s", *(f"{name:>12s}" for name in MEASURES))
    for name in options.scenes:
        tracer = rs.Tracer(rs.load(name))
        reference = rs.render(tracer, "path", size, REFERENCE_SAMPLES, seed=99).pixels
        rows = [
            list(ratios(tracer, size, options.seconds, seed, reference))
            for seed in range(options.seeds)
        ]
        samples, *errors = map(statistics.median, zip(*rows, strict=True))
        print(f"{name:8s} {samples:9.2f}", *(f"{error:12.2f}" for error in errors), flush=True)


if __name__ == "__main__":
    main()
