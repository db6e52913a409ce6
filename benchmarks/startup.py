"""Whole processes, from the command line and back: how long a user waits.

    python benchmarks/startup.py --runs 7

Times `import raystream`, a first image with an empty compile cache, and warm images of a model (the
bunny, if RAYSTREAM_SCENES names a folder that contains it).
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path


def seconds(command, environment):
    started = time.perf_counter()
    subprocess.run(command, env=environment, check=True, capture_output=True)
    return time.perf_counter() - started


def report(name, times):
    low, high = min(times), max(times)
    print(f"{name:42s} median {statistics.median(times):6.2f} s  ({low:.2f} to {high:.2f})")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=5)
    runs = parser.parse_args().runs
    render = [sys.executable, "-m", "raystream", "render"]
    model = Path(os.environ.get("RAYSTREAM_SCENES", ".")) / "bunny" / "bun_zipper.ply"
    warm_scene = str(model) if model.exists() else "robots"
    with tempfile.TemporaryDirectory() as folder:
        picture = str(Path(folder) / "picture.png")
        cold = []
        for run in range(max(2, runs // 3)):
            fresh = {**os.environ, "RAYSTREAM_CACHE_DIR": str(Path(folder) / f"cold-{run}")}
            cold.append(seconds([*render, "-o", picture], fresh))
        command = [*render, warm_scene, "-o", picture]
        seconds(command, fresh)
        warm = [seconds(command, fresh) for _ in range(runs)]
        imports = [seconds([sys.executable, "-c", "import raystream"], fresh) for _ in range(runs)]
    report("import raystream", imports)
    report("first image, nothing compiled", cold)
    report(f"warm image of {Path(warm_scene).name}", warm)


if __name__ == "__main__":
    main()
