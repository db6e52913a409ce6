"""How much memory does a query of rays in a Zarr store take, and does it survive being killed?

    python benchmarks/ray_files.py --rays 200M --scene bunny --folder /tmp/rays

Writes a store of rays, chunk by chunk, from all around the scene to random places in its box. Then
runs ``raystream query`` on it in separate processes: once from start to end, and once more with
``kill -9`` on the way, after which it is resumed each time. Prints the time, the rays per second
and the peak memory of each process, and compares the two stores of hits, file by file. 200 million
rays take 5 GB, and their hits up to 4 GB, twice; ``--keep`` keeps the stores.
"""

import argparse
import filecmp
import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import zarr

import raystream as rs

CHUNK = 1_000_000
UNITS = {"K": 10**3, "M": 10**6, "G": 10**9}


def count(text):
    return int(float(text[:-1]) * UNITS[text[-1]]) if text[-1] in UNITS else int(text)


def write_rays(path, scene, ray_count):
    """Write rays from a sphere around the scene to random places in its box; float32."""
    low, high = (np.asarray(corner, np.float32) for corner in scene.bounds)
    centre, radius = (low + high) / 2, np.linalg.norm(high - low)
    group = zarr.create_group(path)
    arrays = [
        group.create_array(name, shape=(ray_count, 3), chunks=(CHUNK, 3), dtype="float32")
        for name in ("origins", "directions")
    ]
    for begin in range(0, ray_count, CHUNK):
        rng = np.random.default_rng(begin)
        size = min(CHUNK, ray_count - begin)
        away = rng.standard_normal((size, 3), np.float32)
        away *= radius / np.linalg.norm(away, axis=1, keepdims=True)
        origins = centre + away
        directions = low + rng.random((size, 3), np.float32) * (high - low) - origins
        for array, values in zip(arrays, (origins, directions), strict=True):
            array[begin : begin + size] = values


def peak_megabytes(process):
    """The peak memory of a process so far, as reported by Linux."""
    try:
        for line in Path(f"/proc/{process.pid}/status").read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 1024
    except OSError:
        pass
    return 0.0


def rays_done(output):
    try:
        return json.loads(Path(f"{output}.progress.json").read_text())["done"]["rays"]
    except (OSError, ValueError):
        return 0


def run(arguments, rays, output, stop_at=None):
    """Run the command, and kill it at a number of rays; returns figures or None, and memory."""
    command = [sys.executable, "-m", "raystream", "query", arguments.scene, str(rays), "--json"]
    command += ["-o", str(output), f"--{arguments.query}", "--resume"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    peak = 0.0
    while process.poll() is None:
        peak = max(peak, peak_megabytes(process))
        if stop_at is not None and rays_done(output) >= stop_at:
            process.send_signal(signal.SIGKILL)
        time.sleep(0.05)
    out = process.communicate()[0]
    if process.returncode not in (0, -signal.SIGKILL):
        raise SystemExit(f"the command ended with {process.returncode}")
    return json.loads(out) if process.returncode == 0 else None, peak


def show(title, figures, peak):
    traced = figures["rays"] - figures["rays_before"]
    seconds = figures["seconds"]
    print(
        f"{title}: {traced:,} rays in {seconds['trace']:.1f} s, "
        f"{figures['mrays_per_second']} Mrays/s, waiting {seconds['read']:.1f} s for rays and "
        f"{seconds['write']:.1f} s for the disk; at most {peak:,.0f} MB"
    )


def size_of(folder):
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file()) / 1e6


def differing_files(a, b):
    names = [{str(file.relative_to(x)) for file in x.rglob("*") if file.is_file()} for x in (a, b)]
    same = filecmp.cmpfiles(a, b, names[0] & names[1], shallow=False)[0]
    return sorted((names[0] | names[1]) - set(same)), len(names[0])


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--rays", type=count, default=count("10M"))
    parser.add_argument("--scene", default="bunny")
    parser.add_argument("--query", default="first", choices=("first", "any", "multi", "count"))
    parser.add_argument("--kills", type=int, default=2)
    parser.add_argument("--folder", type=Path, default=Path("ray_files"))
    parser.add_argument("--keep", action="store_true")
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    rays = arguments.folder / "rays.zarr"
    outputs = [arguments.folder / name for name in ("whole.zarr", "resumed.zarr")]
    for path in outputs:
        shutil.rmtree(path, ignore_errors=True)
        Path(f"{path}.progress.json").unlink(missing_ok=True)
    if not rays.exists():
        started = time.perf_counter()
        write_rays(rays, rs.load(arguments.scene), arguments.rays)
        print(f"rays: written in {time.perf_counter() - started:.0f} s, {size_of(rays):,.0f} MB")

    figures, peak = run(arguments, rays, outputs[0])
    show("whole", figures, peak)
    print(f"hits: {figures['rays_hit']:,} rays hit, {size_of(outputs[0]):,.0f} MB")

    for kill in range(arguments.kills):
        stop_at = arguments.rays * (kill + 1) // (arguments.kills + 1)
        _, peak = run(arguments, rays, outputs[1], stop_at)
        print(f"killed: {rays_done(outputs[1]):,} rays done; at most {peak:,.0f} MB")
    figures, peak = run(arguments, rays, outputs[1])
    show("resumed", figures, peak)
    differing, total = differing_files(*outputs)
    print(f"{total} files, {len(differing)} differ {differing[:5] or ''}")
    if not arguments.keep:
        shutil.rmtree(arguments.folder)
    sys.exit(bool(differing))


if __name__ == "__main__":
    main()
