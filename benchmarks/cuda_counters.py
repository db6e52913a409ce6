"""What the GPU's hardware counts while it traces, by NVIDIA's Nsight Compute, where that may.

    python benchmarks/cuda_counters.py sponza --json counters.json

Traces the primary rays of a picture once for each way, shuffled, given and sorted, under ``ncu``
(from CUDA_HOME, PATH, or where its installer puts it), and reports for each launch of the query's
kernel: how long it took, warps on a multiprocessor as a share of its most, threads that take part
in an instruction, of 32, hits in the first and second cache, and what part of the memory's
throughput was used. Kernels are slower under ncu: times are for comparison only.

Ends with 0 if something was counted, 1 if that failed, and 3 where ncu is not found, or the driver
lets nobody but the administrator read counters (ERR_NVGPUCTRPERM).
"""

import argparse
import csv
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

#: Ends with this where counters cannot be read.
NOT_HERE = 3

#: What is reported, by ncu's names.
METRICS = {
    "microseconds": "gpu__time_duration.sum",
    "occupancy %": "sm__warps_active.avg.pct_of_peak_sustained_active",
    "threads": "smsp__thread_inst_executed_per_inst_executed.ratio",
    "L1 hits %": "l1tex__t_sector_hit_rate.pct",
    "L2 hits %": "lts__t_sector_hit_rate.pct",
    "DRAM %": "dram__throughput.avg.pct_of_peak_sustained_elapsed",
}

#: ncu's own units, where numbers are to be in others.
SCALES = {"microseconds": 1e-3}

#: Options of a tracer, and whether rays are shuffled.
WAYS = {
    f"{kernel}, {launch}, {order}": (
        {"kernel": kernel, "launch": launch, "order": "sorted" if order == "sorted" else "given"},
        order != "given",
    )
    for kernel in ("compressed", "binary", "packet")
    for launch in ("range", "persistent")
    for order in ("given", "shuffled", "sorted")
}


def find_ncu():
    """Path of ncu, or None."""
    for folder in (os.environ.get("CUDA_HOME"), "/usr/local/cuda"):
        path = Path(folder or "/nowhere", "bin", "ncu")
        if path.is_file():
            return str(path)
    found = sorted(Path("/opt/nvidia/nsight-compute").glob("*/ncu"))
    return shutil.which("ncu") or (str(found[-1]) if found else None)


def number_of(text):
    """A number as ncu writes it, with commas between thousands; None if it is none."""
    try:
        return float(text.replace(",", ""))
    except ValueError:
        return None


def launches_of(said):
    """Launches in the order of their numbers, of what ``ncu --csv`` says.

    Before the table are lines of the program's and of ncu's, which begin with ``==``; a row of it
    is one metric of one launch.
    """
    lines = [line for line in said.splitlines() if not line.startswith("==")]
    titles = ("ID", "Kernel Name", "Metric Name", "Metric Value")
    is_head = [all(f'"{title}"' in line for title in titles) for line in lines]
    if True not in is_head:
        return []
    labels = {name: label for label, name in METRICS.items()}
    found = {}
    for row in csv.DictReader(lines[is_head.index(True) :]):
        if not (row["ID"] or "").isdigit():
            continue
        launch = found.setdefault(int(row["ID"]), {"kernel": row["Kernel Name"]})
        label = labels.get(row["Metric Name"])
        value = number_of(row["Metric Value"] or "")
        if label is not None:
            launch[label] = None if value is None else value * SCALES.get(label, 1.0)
    return [found[number] for number in sorted(found)]


def reason_of(said):
    """Why there are no counters; and whether that is because they cannot be had here."""
    if "ERR_NVGPUCTRPERM" in said:
        return "the driver lets only the administrator read counters (ERR_NVGPUCTRPERM)", True
    errors = [line.strip() for line in said.splitlines() if line.startswith("==ERROR==")]
    if errors:
        return errors[0].removeprefix("==ERROR== "), False
    if "No kernels were profiled" in said:
        return "no kernel was counted", False
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    return (lines[-1] if lines else "it said nothing"), False


def command_of(ncu, scene, size, ways):
    """What counts: ncu, and this script again."""
    metrics = ",".join(METRICS.values())
    options = ["--csv", "--metrics", metrics, "--print-units", "base"]
    options += ["--profile-from-start", "off", "--kernel-name", "regex:first_hit"]
    own = [sys.executable, str(Path(__file__)), scene, "--trace", "--size", size]
    return [ncu, *options, *own, *(word for way in ways for word in ("--way", way))]


def trace(name, size, ways):
    """Trace rays once for each way, while ncu counts."""
    import cuda_speed
    import numpy as np
    from numba import cuda

    import raystream as rs

    scene = rs.load(name)
    width, _, height = size.partition("x")
    camera = scene.camera_for(int(width) / int(height))
    order = cuda_speed.morton(int(width), int(height))
    given = [
        np.ascontiguousarray(np.broadcast_to(one, (int(height), int(width), 3)), "f4")
        for one in camera.rays(int(width), int(height))
    ]
    given = [one.reshape(-1, 3)[order] for one in given]
    rows = np.random.default_rng(1).permutation(len(order))
    shuffled = [one[rows] for one in given]
    for way in ways:
        options, is_shuffled = WAYS[way]
        tracer = rs.Tracer(scene, "bvh", "cuda", **options)
        rays = shuffled if is_shuffled else given
        tracer.first_hit(*rays)  # it is compiled
        with tracer._backend.gpu.current(), cuda.profiling():
            tracer.first_hit(*rays)
    return 0


def line_of(label, launch):
    values = (launch.get(one) for one in METRICS)
    shown = "".join(f"{'-' if one is None else format(one, ',.1f'):>14}" for one in values)
    return f"{label:32}{shown}"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", nargs="?", default="forest:100000")
    parser.add_argument("--size", default="512x384")
    parser.add_argument("--way", action="append", choices=WAYS)
    parser.add_argument("--json", type=Path, help="file for the figures")
    parser.add_argument("--trace", action="store_true", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    ways = asked.way or list(WAYS)
    if asked.trace:
        return trace(asked.scene, asked.size, ways)
    ncu = find_ncu()
    if ncu is None:
        print("ncu: not found; it is in CUDA's toolkit", file=sys.stderr)
        return NOT_HERE
    paths = os.pathsep.join(filter(None, [str(ROOT / "src"), os.environ.get("PYTHONPATH")]))
    environment = {**os.environ, "LC_ALL": "C", "PYTHONPATH": paths}
    command = command_of(ncu, asked.scene, asked.size, ways)
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    launches = launches_of(done.stdout)
    if not launches or not any(one.get(label) for one in launches for label in METRICS):
        reason, is_not_here = reason_of(done.stdout + "\n" + done.stderr)
        print(f"ncu: {reason}", file=sys.stderr)
        return NOT_HERE if is_not_here else 1
    labels = ways if len(launches) == len(ways) else [one["kernel"] for one in launches]
    print(f"{asked.scene:32}" + "".join(f"{label:>14}" for label in METRICS))
    for label, launch in zip(labels, launches, strict=True):
        print(line_of(label[:31], launch))
    if asked.json:
        rows = [{"way": label, **one} for label, one in zip(labels, launches, strict=True)]
        asked.json.write_text(json.dumps({"scene": asked.scene, "launches": rows}, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
