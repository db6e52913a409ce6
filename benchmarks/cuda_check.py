"""Check and measure raystream on a machine with an NVIDIA GPU, in one command of eight minutes.

    pip install -e ".[cuda,test]" warp-lang
    RAYSTREAM_SCENES=/path/to/models python benchmarks/cuda_check.py --json cuda_check.json

Each step runs in its own process with a time limit. A step that fails does not stop the others,
even if a stopped kernel makes CUDA unusable in its process:

    machine      what ``raystream info --devices`` lists
    small scene  all queries of a small scene, on the GPU and on the CPU
    agreement    tests/cuda: every structure, query and case, CUDA's bits against the CPU's
    sanitizer    compute-sanitizer's memcheck while the small scene is queried again
    speed        benchmarks/cuda_speed.py for each scene, compared with NVIDIA Warp

Exits with 0 if nothing failed, 1 if something did, and 2 if there is no GPU. ``--tiny`` tests the
script itself, also in Numba's simulator (``NUMBA_ENABLE_CUDASIM=1``).
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ET
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

#: Seconds for everything, and for each step. A step gets at most the time that is left, and is
#: left out if that is less than the minimum.
TOTAL = 460
LEAST = 5
LIMITS = {"machine": 60, "small scene": 120, "agreement": 150, "sanitizer": 60, "speed": 60}

#: A small part of each step: some tests, and few rays.
TINY_TESTS = "layout or invalid"
TINY = ["--size", "6x4", "--per-hit", "2", "--repeats", "1", "--ours", "grid"]

#: What the small scene is traced with besides each structure: device builds, and float64.
SMALL_WAYS = [
    ("bvh", {"build": "device"}),
    ("grid", {"build": "device"}),
    ("bvh", {"precision": "float64"}),
    ("brute", {"precision": "float64"}),
]

#: Models from public research, and built-in scenes of up to ten million triangles.
SCENES = (
    *("conference", "sibenik", "sponza", "bunny"),
    *("forest:1000000", "forest:10000000"),
)


class Check:
    """Steps, how they ended, and how much time is left.

    Parameters
    ----------
    path : Path or None
        File for the results, written after each step.
    total : float
        Seconds for everything.

    Attributes
    ----------
    results : dict
    """

    def __init__(self, path, total):
        self._path = path
        self._end = time.monotonic() + total
        self.results = {"steps": []}

    def run(self, name, command, limit, summary):
        """Run a step; ``summary(returncode, out, err)`` gives its result in one line."""
        given = min(limit, self._end - time.monotonic())
        started = time.monotonic()
        out = err = ""
        if given < LEAST:
            status, line = "left out", "no time was left"
        else:
            try:
                done = _run(command, given)
                out, err = done.stdout, done.stderr
                status = "failed" if done.returncode else "passed"
                line = summary(done.returncode, out, err)
            except subprocess.TimeoutExpired as error:
                out, err = (_text(one) for one in (error.stdout, error.stderr))
                status, line = "timed out", f"not done after {given:.0f} s"
            except (OSError, ValueError, LookupError) as error:  # or its output is no answer
                status, line = "failed", f"{type(error).__name__}: {error}"
        self.keep(name, status, line, time.monotonic() - started, out, err)
        return status == "passed"

    def keep(self, name, status, line, seconds=0.0, out="", err=""):
        """Record how a step ended, and print it."""
        step = {"step": name, "status": status, "seconds": round(seconds, 1), "line": line}
        if status in ("failed", "timed out"):
            step["output"] = (out + err)[-4000:]
        self.results["steps"].append(step)
        print(f"{name:22}{status:10}{seconds:>7.1f} s  {line}", flush=True)
        self.write()

    def write(self):
        """Write the results so far."""
        if self._path:
            self._path.write_text(json.dumps(self.results, indent=1) + "\n")


def _run(command, limit):
    """Run a process; kill it and its children at the limit."""
    source = str(ROOT / "src")
    paths = os.pathsep.join(filter(None, [source, os.environ.get("PYTHONPATH")]))
    process = subprocess.Popen(
        command,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": paths},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        out, err = process.communicate(timeout=limit)
    except BaseException as error:
        os.killpg(process.pid, 9)
        out, err = process.communicate()
        if isinstance(error, subprocess.TimeoutExpired):
            raise subprocess.TimeoutExpired(command, limit, out, err) from None
        raise
    return subprocess.CompletedProcess(command, process.returncode, out, err)


def _text(said):
    return said.decode(errors="replace") if isinstance(said, bytes) else said or ""


def _last_line(out, err):
    lines = [*out.split("\n"), *err.split("\n")]
    return next((line.strip() for line in reversed(lines) if line.strip()), "it printed nothing")


def agreement(check, tiny):
    """Run all agreement cases and all other tests of the device."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder, "report.xml")
        processes = 0 if tiny else min(8, max(2, (os.cpu_count() or 2) // 2))
        command = [sys.executable, "-m", "pytest", "-q", "-m", "", "-p", "no:cacheprovider"]
        command += [f"--numprocesses={processes}", f"--junitxml={report}"]
        command += ["tests/cuda/test_agreement.py", "-k", TINY_TESTS] if tiny else ["tests/cuda"]

        def summary(_code, out, err):
            try:
                (suite,) = ET.parse(report).iter("testsuite")
            except (OSError, ValueError, ET.ParseError):
                return _last_line(out, err)
            counts = {
                key: int(suite.get(key)) for key in ("tests", "failures", "errors", "skipped")
            }
            check.results["agreement"] = counts
            return ", ".join(f"{count:,} {name}" for name, count in counts.items())

        check.run("agreement", command, LIMITS["agreement"], summary)


def small_scene(check, tiny):
    """Run all queries of a small scene, which compiles most of what the other steps need."""
    check.run("small scene", _small(tiny), LIMITS["small scene"], _small_summary)


def sanitizer(check, tiny):
    """Run the same under the memory checker, if it is installed."""
    tool = find_sanitizer()
    if tool is None:
        check.keep("sanitizer", "left out", "compute-sanitizer: not found; it is in CUDA's toolkit")
        return
    options = ["--tool", "memcheck", "--error-exitcode", "9", "--print-limit", "5"]
    command = [tool, *options, *_small(tiny)]
    check.run("sanitizer", command, LIMITS["sanitizer"], _small_summary)


def _small(tiny):
    return [sys.executable, str(Path(__file__)), "--small", *(["--tiny"] if tiny else [])]


def _small_summary(_code, out, err):
    found = [line.strip("= ") for line in out.split("\n") if "ERROR SUMMARY" in line]
    return found[0] if found else _last_line(out, err)


def find_sanitizer():
    """Path of compute-sanitizer, or None."""
    for folder in (os.environ.get("CUDA_HOME"), "/usr/local/cuda"):
        path = Path(folder or "/nowhere", "bin", "compute-sanitizer")
        if path.is_file():
            return str(path)
    return shutil.which("compute-sanitizer")


def small(tiny):
    """Run all queries of a small scene, and compare the answers with the CPU's."""
    import numpy as np

    import raystream as rs
    from raystream.structures import STRUCTURES

    scene = rs.load("cornell")
    side = 3 if tiny else 24
    rays = [np.ascontiguousarray(one).reshape(-1, 3) for one in scene.camera.rays(side, side)]
    rays[0] = np.broadcast_to(rays[0], (side * side, 3))
    ways = [(name, {}) for name in (["brute", "grid"] if tiny else STRUCTURES)]
    ways += [] if tiny else SMALL_WAYS
    wrong = 0
    for name, options in ways:
        kind = {one: options[one] for one in options if one == "precision"}
        ours, theirs = rs.Tracer(scene, name, "cuda", **options), rs.Tracer(scene, name, **kind)
        for query in ("first_hit", "any_hit", "count_hits", "multi_hit"):
            found, expected = (getattr(one, query)(*rays) for one in (ours, theirs))
            wrong += not _same(found, expected)
    # Scenes with their own kernels: mirrored instances in two worlds, and spheres with triangles.
    places = np.tile(np.eye(3, 4), (3, 1, 1))
    places[1:, :, :3] *= [[[-0.5]], [[0.25]]]
    placed = rs.Scene.instances(scene, places, worlds=[0, 1, -1])
    balls = rs.Scene.spheres(np.arange(30.0).reshape(10, 3) * 20.0, 40.0)
    ground = rs.Scene.height_field(np.sin(np.arange(400.0)).reshape(20, 20), spacing=30.0)
    kinds = [
        (placed, {"worlds": np.arange(side * side) % 2}),
        (rs.Scene.combine([scene, balls, ground]), {}),
    ]
    for held, more in kinds:
        for name in ("brute",) if tiny else ("brute", "bvh"):
            ways.append((name, {}))
            ours, theirs = rs.Tracer(held, name, "cuda"), rs.Tracer(held, name)
            for query in ("first_hit", "any_hit", "count_hits", "multi_hit"):
                found, expected = (getattr(one, query)(*rays, **more) for one in (ours, theirs))
                wrong += not _same(found, expected)
    # Points around the scene, most of them nearest to an edge or a corner.
    points = rays[0] + 300.0 * rays[1]
    for name in ("brute", "bvh"):
        ours, theirs = rs.Tracer(scene, name, "cuda"), rs.Tracer(scene, name)
        found, expected = (one.closest_points(points, 3) for one in (ours, theirs))
        wrong += not _same(found, expected)
    print(f"{len(ways)} tracers, {wrong} queries with different bits than the CPU's")
    return 1 if wrong else 0


def _same(ours, theirs):
    names = ("t", "distance", "positions", "prim_id", "instance_id", "ray_splits")
    columns = [name for name in names if hasattr(ours, name)]
    if not columns:
        return ours.tobytes() == theirs.tobytes()
    return all(getattr(ours, one).tobytes() == getattr(theirs, one).tobytes() for one in columns)


def speed(check, scenes, more):
    """Measure rays per second, in a process for each scene; keep what was done before a limit."""
    check.results["speed"] = []
    for scene in scenes:
        with tempfile.TemporaryDirectory() as folder:
            kept = Path(folder, "speed.json")
            command = [sys.executable, str(ROOT / "benchmarks" / "cuda_speed.py"), scene]
            command += ["--json", str(kept), *more]
            check.run(f"speed, {scene}", command, LIMITS["speed"], _speed_summary)
            if kept.is_file():
                check.results["speed"] += json.loads(kept.read_text())["scenes"]
                check.write()


def _speed_summary(code, out, err):
    return _last_line("", err) if code else f"{max(len(out.splitlines()) - 1, 0)} rows"


def table(check):
    """Print the rates: a line for each scene and set of rays."""
    scenes = check.results.get("speed", [])
    labels = list(dict.fromkeys(row["contender"] for one in scenes for row in one["rows"]))
    if not labels:
        return
    print("\nMrays/s of the kernels alone; with all copies in brackets")
    print(f"{'scene':18}{'rays':9}" + "".join(f"{label:>24}" for label in labels))
    for one in scenes:
        for name in dict.fromkeys(row["set"] for row in one["rows"]):
            cells = {row["contender"]: row for row in one["rows"] if row["set"] == name}
            shown = "".join(f"{_cell(cells.get(label)):>24}" for label in labels)
            print(f"{one['scene']:18}{name:9}{shown}")


def _cell(row):
    if row is None:
        return "-"
    rate, whole = row["mrays_per_second"], row["mrays_per_second_whole"]
    return f"{'-' if rate is None else format(rate, ',.1f')} ({whole:,.3g})"


def reason_against():
    """Why nothing can be checked here; None if there is a GPU, or a simulated one."""
    sys.path.insert(0, str(ROOT / "src"))
    try:
        from raystream.jit.cuda import CudaError, open_gpu
    except ImportError as error:
        return f"needs numba-cuda: pip install 'raystream[cuda]' ({error})"
    try:
        open_gpu()
    except CudaError as error:
        return str(error)
    return None


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, help="file for the results")
    parser.add_argument("--scene", action="append", help=f"[default: {', '.join(SCENES)}]")
    parser.add_argument("--ours", action="append", help="as for cuda_speed.py")
    parser.add_argument("--seconds", type=float, default=TOTAL, help="for everything")
    parser.add_argument("--tiny", action="store_true", help="a small part of each step")
    parser.add_argument("--small", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if reason := reason_against():
        print(f"cuda_check: {reason}", file=sys.stderr)
        return 2
    if arguments.small:
        return small(arguments.tiny)
    check = Check(arguments.json, arguments.seconds)
    listing = [sys.executable, "-m", "raystream", "info", "--devices", "--json"]

    def listed(_code, out, err):
        check.results["machine"] = json.loads(out)
        gpus = check.results["machine"]["cuda"]["gpus"]
        return ", ".join(one["name"] for one in gpus) or _last_line(out, err)

    check.run("machine", listing, LIMITS["machine"], listed)
    small_scene(check, arguments.tiny)
    agreement(check, arguments.tiny)
    sanitizer(check, arguments.tiny)
    more = TINY if arguments.tiny else []
    for word in arguments.ours or []:
        more = [*more, "--ours", word]
    scenes = arguments.scene or (["cornell"] if arguments.tiny else SCENES)
    speed(check, scenes, more)
    table(check)
    is_bad = [one["status"] in ("failed", "timed out") for one in check.results["steps"]]
    return 1 if any(is_bad) else 0


if __name__ == "__main__":
    sys.exit(main())
