"""Rays per second on a GPU: raystream's kernels beside NVIDIA Warp's `mesh_query_ray`.

    python benchmarks/cuda_speed.py sponza forest:1000000 --json speed.json
    python benchmarks/cuda_speed.py bunny --ours bvh --ours grid:resolution=64

After the protocol of Aila and Laine ("Understanding the Efficiency of Ray Traversal on GPUs",
2009): 1024 x 768 primary rays, and 32 secondary rays where each of them hits: for ambient
occlusion, short ones that ask for any hit; for diffuse light, long ones that ask for the first.
Pixels follow each other in Morton order, and the rays of a hit follow each other.

Everyone gets the same rays, in turns, from arrays on the host. Times are those of the kernels, by
events around each launch on the device, with those that sort rays, whose share is listed; and of
the whole call, with all copies. Each part of the
rays is traced several times, and the best time counts. What others find in the first part is
compared with the first of ours, and that, for primary rays, with the CPU's bits.
"""

import argparse
import contextlib
import inspect
import json
import sys
import time
from pathlib import Path

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

#: Rays that are traced together.
PART = 1 << 22

#: raystream's kernels that are measured unless others are asked for: the first is the usual one.
OURS = (
    "bvh",
    "bvh:kernel=wide",
    "bvh:kernel=binary",
    "bvh:kernel=binary,launch=persistent",
    "bvh:kernel=packet",
    "bvh:kernel=compressed",
    "bvh:kernel=compressed,launch=persistent",
    "bvh:kernel=compressed,order=sorted",
    "bvh:kernel=compressed,order=sorted,launch=persistent",
)

#: Warp's ways to build, by label: its own choice, and the one that traces best.
WARP = {"warp": {}, "warp, sah": {"constructor": "sah"}}

#: What takes longer to build than this, seconds, is not built a second time.
PATIENCE = 2.0


@contextlib.contextmanager
def launches():
    """Seconds of all kernels that raystream launches meanwhile; none in the simulator.

    Yields those of all, and of those that sort rays.
    """
    from raystream.cuda import launch as ray_launch
    from raystream.jit.cuda import Gpu

    launch, events, seconds, sorting = Gpu.launch, [], [], []
    taken = inspect.signature(launch)
    sort_rays, sorts = ray_launch.sort_rays, []

    def noted(*arguments, **named):
        begin = len(events)
        order = sort_rays(*arguments, **named)
        sorts.append(slice(begin, len(events)))
        return order

    def timed(gpu, *arguments, **named):
        from cuda.core import EventOptions

        stream = taken.bind(gpu, *arguments, **named).arguments.get("stream") or gpu._legacy.native

        def record():
            with gpu.doing("recording an event"):
                return stream.record(options=EventOptions(timing_enabled=True))

        begin = record()
        launch(gpu, *arguments, **named)
        events.append((gpu, begin, record()))

    Gpu.launch, ray_launch.sort_rays = timed, noted
    try:
        yield seconds, sorting
    finally:
        Gpu.launch, ray_launch.sort_rays = launch, sort_rays
    for gpu, begin, end in events:
        with gpu.doing("reading an event"):
            end.sync()
            seconds.append((end - begin) / 1e3)
    for rows in sorts:
        sorting += seconds[rows]


class Turn:
    """A contender, and how long it took.

    Attributes
    ----------
    label : str
    contender : Contender
    sorting_share : float
        Of the latest kernels' time, what it took to sort rays.
    """

    def __init__(self, label, contender):
        self.label, self.contender = label, contender
        self.sorting_share = 0.0

    def run(self, query, rays):
        """An answer, seconds of its kernels or None, and of the whole."""
        started = time.perf_counter()
        with launches() as (spent, sorting):
            answer = self.contender.run(query, rays, "")
        whole = time.perf_counter() - started
        self.sorting_share = sum(sorting) / sum(spent) if sum(spent) else 0.0
        kernels = getattr(self.contender, "kernel_seconds", None)
        return answer, sum(spent) if spent else kernels, whole


class Ours(Raystream):
    """A tracer with another's structure, if that was built with the same options.

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
        """Build, or take what is built."""
        del geometry  # the scene's
        made = rs.Tracer.__new__(rs.Tracer)
        chosen = made._configure(self._structure, "cuda", self._machine, False, self._options)
        how = chosen.device_options
        self.built = chosen.structure, how.build, how.method
        for other in self._others:
            if other is not self and other.built == self.built:
                made._set(self._scene, other.tracer.structure)
                break
        else:
            made = rs.Tracer(
                self._scene, self._structure, "cuda", machine=self._machine, **self._options
            )
        self._tracer = made


def contenders(words, scene, absent):
    """raystream's, as they were asked for, and Warp's, by label."""
    ours = []
    for word in words:
        ours.append(Ours(word, scene, ours[:]))
        yield word, ours[-1]
    for label, own in WARP.items():
        try:
            yield label, make_contender(Entry(label, "warp", {"device": "cuda", **own}), 1)
        except UnavailableError as error:
            absent[label] = str(error)


def morton(width, height):
    """Pixels of a picture in the order of their interleaved bits."""
    y, x = np.divmod(np.arange(width * height), width)
    codes = np.zeros(len(x), np.int64)
    for bit in range(16):
        codes |= ((x >> bit & 1) << (2 * bit)) | ((y >> bit & 1) << (2 * bit + 1))
    return np.argsort(codes, kind="stable")


def secondary(hits, eye, per_hit, t_max, generator):
    """Cosine-distributed rays where others hit; those of a hit follow each other."""
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


def ray_sets(scene, tracer, size, per_hit, part):
    """Name, query and parts of each set."""
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

    def primary():
        for begin in range(0, len(origins), part):
            rows = slice(begin, begin + part)
            yield Rays(origins[rows], directions[rows], np.inf)

    def spread(name):
        generator = np.random.default_rng([len(name), per_hit])
        step = max(part // per_hit, 1)
        for begin in range(0, len(hits.t), step):
            own = hits[begin : begin + step]
            yield secondary(own, camera.eye, per_hit, ends[name], generator)

    yield "primary", "first", primary()
    yield "ao", "any", spread("ao")
    yield "diffuse", "first", spread("diffuse")


def same_bits(ours, structure, rays):
    """Rays whose first hit has other bits than the CPU finds with the same structure."""
    tracer = rs.Tracer.of_structure(structure)
    theirs = tracer.first_hit(rays.origins, rays.directions, t_max=rays.t_max)
    is_other = ours.prim_id.ravel() != theirs.prim_id
    return int((is_other | (ours.t.ravel().view("i4") != theirs.t.view("i4"))).sum())


def trace_set(name, query, parts, turns, repeats):
    """Rates of a set; the first turn's answers are what others are compared with."""
    kernels, whole = ({turn.label: [] for turn in turns} for _ in range(2))
    count, other_bits, differing = 0, None, {}
    for number, rays in enumerate(parts):
        count += len(rays)
        answers, best = {}, {turn.label: (np.inf, np.inf) for turn in turns}
        for again in range(repeats + (number == 0)):  # the first time, something is compiled
            for turn in turns:
                answers[turn.label], device, total = turn.run(query, rays)
                if number or again:
                    before = best[turn.label]
                    device = np.inf if device is None else device
                    best[turn.label] = min(before[0], device), min(before[1], total)
        for turn in turns:
            kernels[turn.label].append(best[turn.label][0])
            whole[turn.label].append(best[turn.label][1])
            if number == 0:
                differing[turn.label] = compare(
                    query, outcome(answers[turns[0].label]), outcome(answers[turn.label])
                )
        first = answers[turns[0].label]
        if name == "primary" and number == 0 and isinstance(first, FirstHits):
            other_bits = same_bits(first, turns[0].contender.tracer.structure, rays)
    for turn in turns:
        device, total = sum(kernels[turn.label]), sum(whole[turn.label])
        yield {
            "set": name,
            "query": query,
            "rays": count,
            "contender": turn.label,
            "mrays_per_second": count / device / 1e6 if 0.0 < device < np.inf else None,
            "mrays_per_second_whole": count / total / 1e6 if total else None,
            "sorting_share": round(turn.sorting_share, 4),
            "differing": differing[turn.label].differing if differing else 0.0,
            "other_bits_than_cpu": other_bits if turn is turns[0] else None,
        }


def built(scene, words, absent):
    """Contenders that are there, with their builds' seconds."""
    geometry = geometry_of(scene)
    for label, contender in contenders(words, scene, absent):
        seconds = []
        try:
            for _ in range(2):  # the first may compile
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
    """All that is measured of a scene; `keep` is called after each step."""
    scene = rs.load(name)
    found = {"scene": name, "triangles": len(scene.triangles), "absent": {}, "builds": {}}
    found["rows"] = []
    keep(found)
    turns = []
    for turn, seconds in built(scene, arguments.ours, found["absent"]):
        turns.append(turn)
        found["builds"][turn.label] = round(seconds, 4)
    if not turns or turns[0].label != arguments.ours[0]:
        raise rs.RaystreamError(f"{arguments.ours[0]}: {found['absent'].get(arguments.ours[0])}")
    width, _, height = arguments.size.partition("x")
    size = int(width), int(height)
    tracer = turns[0].contender.tracer
    for set_name, query, parts in ray_sets(scene, tracer, size, arguments.per_hit, arguments.part):
        for row in trace_set(set_name, query, parts, turns, arguments.repeats):
            found["rows"].append(row)
            print(line_of(found, row), flush=True)
        keep(found)


def line_of(found, row):
    """A row for people."""
    rates = (row["mrays_per_second"], row["mrays_per_second_whole"])
    shown = "".join(f"{'-' if rate is None else format(rate, ',.2f'):>12}" for rate in rates)
    bits = row["other_bits_than_cpu"]
    note = "" if bits is None else f"  {bits} rays with other bits than the CPU"
    build = found["builds"][row["contender"]]
    return (
        f"{found['scene']:18}{found['triangles']:>11,}{row['set']:>9}{row['rays']:>12,}  "
        f"{row['contender']:18}{shown}{100 * row['sorting_share']:>8.1f}"
        f"{build:>9.3f}{100 * row['differing']:>9.4f}{note}"
    )


TITLES = (
    f"{'scene':18}{'triangles':>11}{'set':>9}{'rays':>12}  {'contender':18}"
    f"{'Mrays/s':>12}{'with copies':>12}{'sort %':>8}{'build s':>9}{'differ %':>9}"
)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--ours", action="append", help="STRUCTURE[:KEY=VALUE,...]")
    parser.add_argument("--size", default="1024x768")
    parser.add_argument("--per-hit", type=int, default=32)
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--part", type=int, default=PART)
    parser.add_argument("--json", type=Path, help="file for the figures, written after each set")
    arguments = parser.parse_args()
    arguments.ours = arguments.ours or list(OURS)
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
