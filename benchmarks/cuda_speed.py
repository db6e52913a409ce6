"""Rays per second on a GPU: raystream's kernels against NVIDIA Warp's `mesh_query_ray`.

    python benchmarks/cuda_speed.py sponza forest:1000000 --json speed.json
    python benchmarks/cuda_speed.py bunny --ours bvh --ours grid:resolution=64 --shuffled

Follows the protocol of Aila and Laine ("Understanding the Efficiency of Ray Traversal on GPUs",
2009): 1024 x 768 primary rays, and 8 secondary rays for each hit. Those for ambient occlusion are
short any-hit rays, those for diffuse light are long first-hit rays. Pixels are in Morton order, and
the rays of a hit follow each other; with ``--shuffled`` each set is also traced in random order.

All contenders trace the same rays, alternately, from arrays on the device, and leave results there.
Times are those of the kernels, measured by events around each launch on the device, and those of
the whole call, until the device is done: medians of several repeats. Answers are compared with
those of the first contender, and the latter's, for primary rays, with the CPU's bits. With ``--lock
FILE``, several processes prepare scenes at the same time, and measure one after another.
"""

import argparse
import contextlib
import fcntl
import inspect
import json
import statistics
import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

import raystream as rs
from raystream.bench.agreement import compare, outcome
from raystream.bench.contenders import Entry, make_contender
from raystream.bench.contenders.base import FirstHits, Rays, UnavailableError
from raystream.bench.contenders.own import Raystream
from raystream.bench.ray_sets import AO_LENGTH
from raystream.bench.runner import geometry_of
from raystream.cli.tracer_options import parse_keywords
from raystream.jit.threads import thread_count

#: raystream's structures that are measured by default; the first is the default structure.
OURS = ("bvh", "bvh:build=device", "kdtree", "graph", "grid")

#: Warp's constructors, by label; the first entry leaves the choice to Warp.
WARP = {
    "warp": {},
    **{f"warp, {one}": {"constructor": one} for one in ("sah", "median", "lbvh", "cubql")},
}

#: Number of rays of a set whose answers are compared.
COMPARED = 1 << 20

#: Seconds: a structure that takes longer to build is not built a second time.
PATIENCE = 2.0


@contextlib.contextmanager
def launches():
    """Yield a list, filled at the end with the seconds of all kernels; empty in the simulator."""
    from raystream.jit.cuda import Gpu

    launch, events, seconds = Gpu.launch, [], []
    taken = inspect.signature(launch)

    def timed(gpu, *arguments, **named):
        from cuda.core import EventOptions

        stream = taken.bind(gpu, *arguments, **named).arguments.get("stream") or gpu._legacy.native

        def record():
            with gpu.doing("recording an event"):
                return stream.record(options=EventOptions(timing_enabled=True))

        begin = record()
        launch(gpu, *arguments, **named)
        events.append((gpu, begin, record()))

    Gpu.launch = timed
    try:
        yield seconds
    finally:
        Gpu.launch = launch
    for gpu, begin, end in events:
        with gpu.doing("reading an event"):
            end.sync()
            seconds.append((end - begin) / 1e3)


class DeviceRays(NamedTuple):
    """Rays in arrays on the device.

    Attributes
    ----------
    origins, directions : device array of shape (N, 3), float32
    t_max : float
    """

    origins: object
    directions: object
    t_max: float

    @classmethod
    def of(cls, rays):
        """Copy rays to the device."""
        from raystream.jit.cuda import open_gpu

        gpu = open_gpu()
        origins, directions = (gpu.upload("rays", one) for one in rays.rows())
        return cls(origins, directions, rays.t_max)

    def __len__(self):
        return len(self.origins)

    def rows(self):
        """Origins and directions."""
        return self.origins, self.directions


class Turn:
    """A contender, whose queries are timed.

    Attributes
    ----------
    label : str
    contender : Contender
    """

    def __init__(self, label, contender):
        self.label, self.contender = label, contender

    def run(self, query, rays):
        """An answer on the device, the seconds of its kernels or None, and of the whole call."""
        from numba import cuda

        cuda.synchronize()
        started = time.perf_counter()
        self.contender.run(query, rays, "")
        cuda.synchronize()
        whole = time.perf_counter() - started
        with launches() as spent:  # a second run, since its events take time
            answer = self.contender.run(query, rays, "")
        kernels = getattr(self.contender, "kernel_seconds", None)
        return answer, sum(spent) if spent else kernels, whole


def on_host(answer):
    """An answer as NumPy arrays."""
    if isinstance(answer, FirstHits):
        return FirstHits(_on_host(answer.t), _on_host(answer.prim_id))
    return _on_host(answer)


def _on_host(array):
    """A device array of raystream or Warp as a NumPy array."""
    return array.host() if hasattr(array, "host") else array.numpy()


class Ours(Raystream):
    """A tracer that shares another's structure, if that was built with the same options.

    Parameters
    ----------
    word : str
        ``STRUCTURE[:KEY=VALUE,...]``.
    scene : Scene
    others : list of Ours
    """

    def __init__(self, word, scene, others):
        self._structure, _, rest = word.partition(":")
        options = parse_keywords("--ours", rest.split(",")) if rest else {}
        self._machine = options.pop("machine", None)
        super().__init__(thread_count(), options)
        self._scene, self._others = scene, others
        self.built = None

    def build(self, geometry):
        """Build the structure, or share one that is built."""
        del geometry  # the scene has it
        made = rs.Tracer.__new__(rs.Tracer)
        chosen = made._configure(self._structure, "cuda", self._machine, False, self._options)
        self.built = chosen.structure, chosen.device_options.build
        for other in self._others:
            if other is not self and other.built == self.built:
                made._set(self._scene, other.tracer.structure)
                break
        else:
            made = rs.Tracer(
                self._scene, self._structure, "cuda", machine=self._machine, **self._options
            )
        self._tracer = made


def contenders(words, scene, warp, absent):
    """raystream's contenders as they were requested, then Warp's, by label."""
    ours = []
    for word in words:
        ours.append(Ours(word, scene, ours[:]))
        yield word, ours[-1]
    for label, own in warp.items():
        try:
            yield label, make_contender(Entry(label, "warp", {"device": "cuda", **own}), 1)
        except UnavailableError as error:
            absent[label] = str(error)


def morton(width, height):
    """Pixels of an image in Morton order."""
    y, x = np.divmod(np.arange(width * height), width)
    codes = np.zeros(len(x), np.int64)
    for bit in range(16):
        codes |= ((x >> bit & 1) << (2 * bit)) | ((y >> bit & 1) << (2 * bit + 1))
    return np.argsort(codes, kind="stable")


def secondary(hits, eye, per_hit, t_max, generator):
    """Cosine-distributed rays from hits; those of a hit follow each other."""
    normals = hits.normals.astype(np.float32)
    toward = np.asarray(eye) - hits.positions
    normals[np.einsum("ij,ij->i", normals, toward) < 0.0] *= -1.0
    origins, _ = hits.spawn(normals)
    ball = generator.standard_normal((len(normals), per_hit, 3), np.float32)
    ball /= np.linalg.norm(ball, axis=-1, keepdims=True)
    directions = normals[:, None] + 0.9999 * ball  # never 0
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    spread = np.repeat(np.asarray(origins, np.float32), per_hit, axis=0)
    return Rays(spread, directions.reshape(-1, 3), t_max)


def ray_sets(scene, tracer, size, per_hit):
    """Yield the name, query and rays of each set."""
    width, height = size
    camera = scene.camera_for(width / height)
    given = camera.rays(width, height)
    order = morton(width, height)
    origins, directions = (
        np.ascontiguousarray(np.broadcast_to(one, (height, width, 3)).reshape(-1, 3)[order], "f4")
        for one in given
    )
    low, high = tracer.structure.triangles.world_bounds
    found = tracer.first_hit(origins, directions)
    hits = found[found.is_hit]
    ends = {"ao": AO_LENGTH * float(np.linalg.norm(high - low)), "diffuse": np.inf}
    yield "primary", "first", Rays(origins, directions, np.inf)
    for name, query in (("ao", "any"), ("diffuse", "first")):
        generator = np.random.default_rng([len(name), per_hit])
        yield name, query, secondary(hits, camera.eye, per_hit, ends[name], generator)


def same_bits(ours, structure, rays):
    """Number of rays whose first hit has different bits than on the CPU with the same structure."""
    tracer = rs.Tracer.of_structure(structure)
    theirs = tracer.first_hit(rays.origins, rays.directions, t_max=rays.t_max)
    is_other = ours.prim_id.ravel() != theirs.prim_id
    return int((is_other | (ours.t.ravel().view("i4") != theirs.t.view("i4"))).sum())


def trace_set(name, query, rays, turns, repeats):
    """Yield the rates of a set; answers are compared with those of the first contender."""
    kernels, whole = ({turn.label: [] for turn in turns} for _ in range(2))
    given, first, differing, other_bits = DeviceRays.of(rays), None, {}, None
    for again in range(repeats + 1):  # the first run may compile
        for turn in turns:
            answer, device, total = turn.run(query, given)
            if again:
                kernels[turn.label].append(np.nan if device is None else device)
                whole[turn.label].append(total)
                continue
            answer = on_host(answer)
            if turn is turns[0]:
                first = answer
            own, other = (outcome(few_of(one)) for one in (first, answer))
            differing[turn.label] = compare(query, own, other).differing
    if name == "primary":
        other_bits = same_bits(first, turns[0].contender.tracer.structure, rays)
    for turn in turns:
        device, total = (statistics.median(one[turn.label]) for one in (kernels, whole))
        yield {
            "set": name,
            "query": query,
            "rays": len(rays),
            "contender": turn.label,
            "mrays_per_second": len(rays) / device / 1e6 if device > 0.0 else None,
            "mrays_per_second_whole": len(rays) / total / 1e6 if total else None,
            "differing": differing[turn.label],
            "other_bits_than_cpu": other_bits if turn is turns[0] else None,
        }


def few_of(answer):
    """The answers that are compared."""
    if isinstance(answer, FirstHits):
        return FirstHits(*(one[:COMPARED] for one in answer))
    return answer[:COMPARED]


def in_orders(rays, shuffled):
    """Yield the rays as they are given and, if requested, in random order."""
    yield "given", rays
    if shuffled:
        order = np.random.default_rng(len(rays)).permutation(len(rays))
        yield "shuffled", Rays(rays.origins[order], rays.directions[order], rays.t_max)


def built(scene, words, warp, absent):
    """Yield the available contenders, with the seconds of their builds."""
    geometry = geometry_of(scene)
    for label, contender in contenders(words, scene, warp, absent):
        seconds = []
        try:
            for _ in range(2):  # the first build may compile
                started = time.perf_counter()
                contender.build(geometry)
                seconds.append(time.perf_counter() - started)
                if seconds[0] > PATIENCE:
                    break
        except (rs.RaystreamError, ValueError, TypeError, RuntimeError) as error:
            absent[label] = " ".join(str(error).split())
            print(f"{label}: {absent[label]}", file=sys.stderr)
            continue
        yield Turn(label, contender), min(seconds)


def measure(name, arguments, keep):
    """Measure everything for a scene; `keep` is called after each step."""
    scene = rs.load(name)
    found = {"scene": name, "triangles": len(scene.triangles), "absent": {}, "builds": {}}
    found["rows"] = []
    keep(found)
    turns = []
    for turn, seconds in built(scene, arguments.ours, arguments.warp, found["absent"]):
        turns.append(turn)
        found["builds"][turn.label] = round(seconds, 4)
    if not turns or turns[0].label != arguments.ours[0]:
        raise rs.RaystreamError(f"{arguments.ours[0]}: {found['absent'].get(arguments.ours[0])}")
    width, _, height = arguments.size.partition("x")
    size = int(width), int(height)
    tracer = turns[0].contender.tracer
    sets = list(ray_sets(scene, tracer, size, arguments.per_hit))
    for _, query, rays in sets:  # compile
        few = DeviceRays.of(Rays(rays.origins[:1], rays.directions[:1], rays.t_max))
        for turn in turns:
            turn.run(query, few)
    with alone(arguments.lock):
        for set_name, query, rays in sets:
            for order, own in in_orders(rays, arguments.shuffled):
                for row in trace_set(set_name, query, own, turns, arguments.repeats):
                    row["rays_come"] = order
                    found["rows"].append(row)
                    print(line_of(found, row), flush=True)
                keep(found)


@contextlib.contextmanager
def alone(path):
    """Wait until no other process with the same lock file is measuring."""
    if path is None:
        yield
        return
    with open(path, "w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def line_of(found, row):
    """A line of the printed table."""
    rates = (row["mrays_per_second"], row["mrays_per_second_whole"])
    shown = "".join(f"{'-' if rate is None else format(rate, ',.2f'):>12}" for rate in rates)
    bits = row["other_bits_than_cpu"]
    note = "" if bits is None else f"  {bits} rays with different bits than the CPU"
    build = found["builds"][row["contender"]]
    return (
        f"{found['scene']:18}{found['triangles']:>11,}{row['set']:>9}{row['rays_come']:>10}"
        f"{row['rays']:>12,}  {row['contender']:24}{shown}"
        f"{build:>9.3f}{100 * row['differing']:>9.4f}{note}"
    )


TITLES = (
    f"{'scene':18}{'triangles':>11}{'set':>9}{'order':>10}{'rays':>12}  {'contender':24}"
    f"{'Mrays/s':>12}{'whole call':>12}{'build s':>9}{'differ %':>9}"
)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--ours", action="append", help="STRUCTURE[:KEY=VALUE,...]")
    parser.add_argument("--size", default="1024x768")
    parser.add_argument("--per-hit", type=int, default=8)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--shuffled", action="store_true", help="also trace in random order")
    parser.add_argument("--no-warp", action="store_true")
    parser.add_argument("--lock", type=Path, help="lock file shared by measuring processes")
    parser.add_argument("--json", type=Path, help="file for the figures, written after each set")
    arguments = parser.parse_args()
    arguments.ours = arguments.ours or list(OURS)
    arguments.warp = {} if arguments.no_warp else WARP
    scenes, failures = [], 0
    print(TITLES)

    def keep(_found):
        if arguments.json:
            arguments.json.write_text(json.dumps({"scenes": scenes}, indent=1) + "\n")

    for name in arguments.scenes:
        try:
            measure(name, arguments, lambda found: (_add(scenes, found), keep(found)))
        except rs.RaystreamError as error:
            print(f"{name}: {error}", file=sys.stderr)
            failures += 1
    return 1 if failures else 0


def _add(scenes, found):
    if not any(one is found for one in scenes):
        scenes.append(found)


if __name__ == "__main__":
    sys.exit(main())
