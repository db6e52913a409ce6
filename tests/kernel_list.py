"""The kernels that `raystream warm` compiles, recorded from commands in separate processes.

python tests/kernel_list.py            # updates src/raystream/jit/kernels.json
python tests/kernel_list.py render-ao  # prints the kernels of one task as JSON
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

MODES = ("raycast", "vis", "shadow", "whitted", "xray", "ao", "kajiya", "path")
#: Modes whose shading has a copy for plain scenes.
COPIED_MODES = ("raycast", "shadow", "whitted", "kajiya", "path")
QUALITIES = ("balanced", "fast")
QUERIES = ("first", "any", "multi", "count", "filter", "closest")
TASKS = (
    *(f"build-{how}" for how in (*QUALITIES, "update", "large")),
    *(f"render-{mode}" for mode in MODES),
    *(f"render-{mode}:full" for mode in COPIED_MODES),
    *(f"query-{kind}" for kind in QUERIES),
)

#: Triangles of a scene whose first splits are made by several threads.
LARGE = 400_000

#: Width and height of an image: rows are longer than the smallest batch for packets.
SIZE = "1100x40"


def write(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def write_hills(count: int = 128) -> None:
    """Write ``hills.obj``, with a texture, and enough triangles for all kernels of a build."""
    places = [(i / count, k / count) for i in range(count + 1) for k in range(count + 1)]
    corners = [f"v {x} {0.1 * math.sin(9 * x) * math.sin(7 * z)} {z}" for x, z in places]
    texcoords = [f"vt {x} {z}" for x, z in places]
    firsts = [i * (count + 1) + k + 1 for i in range(count) for k in range(count)]
    faces = [
        "f " + " ".join(f"{at}/{at}" for at in (a, a + 1, a + count + 2, a + count + 1))
        for a in firsts
    ]
    lines = ["mtllib hills.mtl", "usemtl grass", *corners, *texcoords, *faces, ""]
    Path("hills.obj").write_text("\n".join(lines), encoding="ascii")
    Path("hills.mtl").write_text("newmtl grass\nmap_Kd grass.ppm\n", encoding="ascii")
    Path("grass.ppm").write_text("P3 1 1 255 50 200 50\n", encoding="ascii")


def render(what: str) -> None:
    from raystream.cli import main

    mode, _, kind = what.partition(":")
    if kind:
        write_hills()
    scene = "hills.obj" if kind else "robots"
    # As a preview, but without a limit of time: it decides how many samples are traced at once.
    usual: tuple[str, ...] = ()
    if mode in ("kajiya", "path"):
        usual = "--samples", "16", "--denoise"
    sys.modules["pyoidn"] = None  # type: ignore[assignment]  # the filter of a plain installation
    for name, more in (("a.png", usual), ("b.png", ("--samples", "2"))):
        with contextlib.suppress(SystemExit):
            main(["render", scene, "-o", name, "--mode", mode, "--size", SIZE, *more])


def query(kind: str) -> None:
    import numpy as np

    import raystream as rs

    tracer = rs.Tracer(rs.load("spheres"))
    if kind == "closest":
        tracer.closest_point([0.0, 0.0, 0.0])
        tracer.contains([0.0, 0.0, 0.0])
        return
    rng = np.random.default_rng(0)
    ask = getattr(tracer, {"any": "any_hit", "count": "count_hits"}.get(kind, f"{kind}_hit"), None)
    if kind == "filter":  # the traversals that call one

        def ask(origins: Any, directions: Any) -> Any:
            skipped = np.full(directions.shape[:-1], -1)
            return tracer.first_hit(origins, directions, skip_prim_ids=skipped)

    origins, directions = tracer.scene.camera.rays(300, 200)
    ask(origins[0, 0], directions[0, 0])
    if kind == "first":
        tracer.cast(origins[0, 0], directions[0, 0])
    for dtype in (np.float32, np.float64):
        rays = np.array([origins, directions], dtype)
        ask(*rays)
        ask(*rays.reshape(2, -1, 3))
        ask(*rng.permutation(rays.reshape(2, -1, 3), axis=1))


def build(how: str) -> None:
    import numpy as np

    import raystream as rs

    if how == "large":  # as read from a file
        corners = np.random.default_rng(0).random((LARGE, 3), np.float32)
        faces = np.arange(3 * LARGE, dtype=np.int32).reshape(-1, 3) % LARGE
        rs.Tracer(rs.Scene.from_arrays(corners, faces))
        return
    scene = rs.load("robots")
    tracer = rs.Tracer(scene, quality=how if how in QUALITIES else "balanced")
    if how == "update":
        tracer.update([mesh.vertices * 2.0 for mesh in scene.meshes])


def record(task: str) -> list[dict[str, Any]]:
    """Run a task in this process, and record each kernel that it requests from the cache."""
    from raystream.cli import compiling
    from raystream.jit import signatures
    from raystream.jit.cache import KernelCache

    rows: list[dict[str, Any]] = []
    load, save = KernelCache.load_overload, KernelCache.save_overload
    begun: dict[Any, float] = {}

    def note(self: Any, sig: Any, context: Any) -> Any:
        types = [signatures.encode_type(one) for one in sig]
        rows.append({"kernel": self.name, "types": types, "seconds": 0.0})
        begun[self, sig] = time.thread_time()
        return load(self, sig, context)

    def note_end(self: Any, sig: Any, data: Any) -> None:
        row = next(r for r in reversed(rows) if r["kernel"] == self.name)
        row["seconds"] = round(time.thread_time() - begun[self, sig], 2)
        save(self, sig, data)

    # Each kernel is compiled when it is requested, so that its seconds are its own.
    compiling.KernelCompilation._compile_all = lambda *_: None  # type: ignore[method-assign]
    KernelCache.load_overload, KernelCache.save_overload = note, note_end  # type: ignore[method-assign]
    kind, _, name = task.partition("-")
    {"render": render, "query": query, "build": build}[kind](name)
    return rows


def run(task: str, folder: Path | None = None) -> list[dict[str, Any]]:
    """The result of `record` in a separate process, with an empty cache if a folder is given."""
    environment = dict(os.environ)
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))
    # One thread: no helper compiles the kernels that are timed here, and the batches of a picture
    # have the same size on every machine.
    environment["RAYSTREAM_THREADS"] = "1"
    if folder is not None:
        environment["RAYSTREAM_CACHE_DIR"] = str(folder)
    with tempfile.TemporaryDirectory() as place:
        command = [sys.executable, str(Path(__file__).resolve()), task]
        done = subprocess.run(
            command, cwd=place, env=environment, capture_output=True, text=True, check=False
        )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def renew() -> None:
    from raystream.jit.warm import FILE, entries_of

    found: dict[str, dict[str, Any]] = {}
    before = {entry.kernel: entry.seconds for entry in entries_of("all")} if FILE.exists() else {}
    folder = tempfile.TemporaryDirectory()
    for task in TASKS:
        rows = run(task, Path(folder.name))
        write(f"{task}: {len(rows)} kernels, {sum(r['seconds'] for r in rows):.1f} s")
        for row in rows:
            if None in row["types"]:
                write(f"  cannot be listed: {row['kernel']}")
                continue
            known = found.setdefault(json.dumps([row["kernel"], row["types"]]), row | {"tasks": []})
            known["tasks"].append(task)
            of_before = before.get(row["kernel"], 0.0)
            known["seconds"] = max(known["seconds"], row["seconds"], of_before)
    lines = [
        json.dumps({k: row[k] for k in ("kernel", "types", "tasks", "seconds")})
        for row in found.values()
    ]
    folder.cleanup()
    FILE.write_text("[\n" + ",\n".join(lines) + "\n]\n", encoding="utf-8")


if __name__ == "__main__":
    if sys.argv[1:]:
        write(json.dumps(record(sys.argv[1])))
    else:
        renew()
