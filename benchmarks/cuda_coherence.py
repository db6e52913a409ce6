"""Ways to use coherence against divergence on a GPU, side by side; without a GPU, what it may gain.

    python benchmarks/cuda_coherence.py sponza conference spheres
    python benchmarks/cuda_coherence.py sponza --rates --json coherence.json

Rays are those of `cuda_speed`: primary rays, and those for ambient occlusion and for diffuse light
where they hit. They come as they are given (pixels in Morton order, the rays of a hit after each
other), shuffled, and sorted by the keys of `raystream.cuda.ray_order`.

With a GPU, rays per second of all orders, launches and kernels, in turns in one run, and the share
of the time that sorting takes. Without one (or with ``--counts``), counts, which are no speed, of
the kernels as they are compiled for the CPU:

    nodes, tests   that a ray meets, in the BVH's usual layout
    lanes          of the turns that warps of 32 take, the share in which a lane has something to
                   do: a warp takes as many turns as its longest ray has nodes, and tests
    blocks         of the time that blocks of four warps take, the share in which a warp has rays:
                   what a thread for each ray leaves idle, and threads that stay do not
    refilled       the share of lanes if a warp got new rays as soon as fewer than 20 of its lanes
                   have any, which none of the kernels does
    longest, all   nodes of a binary tree that a ray of a warp must visit, for the longest of its
                   rays and for all: those before its hit. A warp that goes through the tree
                   together, as a packet, visits all; one of single rays takes the longest's turns,
                   and reads no more than all
"""

import argparse
import json
import sys
from pathlib import Path

import numba
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

import cuda_speed

import raystream as rs
from raystream.bench.contenders.base import Rays
from raystream.core.rays import RayBatch
from raystream.jit.user_loops import compile_loop
from raystream.kernels.ray_source import RaySource, ResultAddresses
from raystream.kernels.tally import COLUMNS, new_tallies

WARP = 32

#: Warps of a block that has a thread for each ray.
BLOCK_WARPS = 4

#: Aila and Laine's threshold ("Understanding the Efficiency of Ray Traversal on GPUs, Kepler and
#: Fermi Addendum", 2012).
LEAST_LANES = 20

ORDERS = ("given", "shuffled", "sorted")

#: Ways to trace that are measured with a GPU.
WAYS = tuple(
    f"bvh:kernel={kernel},launch={launch},order={order}"
    for kernel in ("compressed", "binary", "packet", "wide")
    for launch in ("range", "persistent")
    for order in ("given", "sorted")
)


# ---- Counts.


def address(array):
    return np.uint64(array.ctypes.data)


_LOOP = """
def loop(count, arguments):
    for i in range(count):
        function(i, *arguments)
"""


def run_on_cpu(kernel, count, arguments):
    """Run a kernel for each number of a range, as it is compiled for the CPU."""
    if count:
        compile_loop(_LOOP, kernel.function, {}, __name__)(np.uint64(count), arguments)


def source_of(rays):
    """Where rays lie, and what must be kept."""
    batch = RayBatch(rays.origins, rays.directions, 0.0, rays.t_max)
    return RaySource.of(batch.origins, batch.directions, batch.limits)


def met_by(structure, query, rays):
    """Nodes and tests of each ray in the usual layout."""
    from raystream.cuda.bvh.kernels import lay_out
    from raystream.cuda.structures import kernels_of

    kernels, (tree, _kept) = kernels_of("bvh"), lay_out(structure)
    source, _rays = source_of(rays)
    answers, tallies = np.zeros((6, len(rays)), np.float32), new_tallies(len(rays))
    to = ResultAddresses(*map(address, answers))
    kernel = kernels.any_hit if query == "any" else kernels.first_hit
    run_on_cpu(kernel, len(rays), (source, structure.frame, tree, address(tallies), to))
    return tallies[:, COLUMNS.index("steps")], tallies[:, COLUMNS.index("tests")]


def keys_of(structure, rays):
    """The keys that the device would sort rays by."""
    from raystream.cuda.ray_order import MAKE_KEY

    source, _rays = source_of(rays)
    keys, numbers = np.zeros((2, len(rays)), np.uint32)
    arguments = source, structure.frame, address(keys), address(numbers)
    run_on_cpu(MAKE_KEY, len(rays), arguments)
    return keys


def in_warps(values):
    """Rows of 32; what is left over is left out."""
    return values[: len(values) // WARP * WARP].reshape(-1, WARP).astype(np.int64)


def lanes_used(nodes, tests):
    """The share of all lanes' turns in which one has something to do."""
    turns = turns_of(nodes, tests)
    return float((in_warps(nodes) + in_warps(tests)).sum() / max(WARP * turns.sum(), 1))


def turns_of(nodes, tests):
    """Turns of each warp."""
    return in_warps(nodes).max(axis=1) + in_warps(tests).max(axis=1)


def blocks_used(turns):
    """The share of a block's time in which its warps have rays."""
    turns = turns[: len(turns) // BLOCK_WARPS * BLOCK_WARPS].reshape(-1, BLOCK_WARPS)
    return float(turns.sum() / max(BLOCK_WARPS * turns.max(axis=1).sum(), 1))


@numba.njit
def lanes_refilled(turns, least):
    """The share of lanes used by a warp that fetches rays for lanes without, when they are many."""
    left = np.zeros(WARP, np.int64)
    next_ray, spent, busy = 0, 0, 0
    while True:
        active = np.count_nonzero(left)
        if active < least:
            for lane in range(WARP):
                while left[lane] == 0 and next_ray < len(turns):
                    left[lane] = turns[next_ray]
                    next_ray += 1
            active = np.count_nonzero(left)
        if active == 0:
            return busy / max(WARP * spent, 1)
        spent += 1
        busy += active
        for lane in range(WARP):
            left[lane] -= left[lane] != 0


@numba.njit(error_model="numpy")
def _enters(node, side, origin, inverse, end):
    """Whether a ray enters the box of a node's child before its end."""
    t_in, t_out = 0.0, end
    for axis in range(3):
        at = 4 * side + 2 * axis if axis < 2 else 8 + 2 * side
        a = (node[at] - origin[axis]) * inverse[axis]
        b = (node[at + 1] - origin[axis]) * inverse[axis]
        t_in, t_out = max(t_in, min(a, b)), min(t_out, max(a, b))
    return t_in <= t_out


@numba.njit(error_model="numpy")
def visits(nodes, links, origins, inverses, ends):
    """For each warp, the nodes of its longest ray, and all different ones of its rays.

    The nodes are those of `raystream.cuda.bvh.binary`; rays are local ones.
    """
    count = len(origins) // WARP
    longest, every = np.zeros(count, np.int64), np.zeros(count, np.int64)
    seen = np.full(len(nodes), -1)
    stack = np.zeros(len(nodes) + 1, np.int64)
    for warp in range(count):
        for ray in range(warp * WARP, (warp + 1) * WARP):
            own, top = 0, 1
            stack[0] = 0
            while top:
                top -= 1
                row = stack[top]
                own += 1
                if seen[row] != warp:
                    seen[row] = warp
                    every[warp] += 1
                for side in range(2):
                    child = links[row, 12 + side]
                    if child > 0 and _enters(
                        nodes[row], side, origins[ray], inverses[ray], ends[ray]
                    ):
                        stack[top] = child
                        top += 1
            longest[warp] = max(longest[warp], own)
    return longest, every


def must_visit(structure, rays, t, order):
    """Means of `visits`; a ray ends at its hit, or its limit."""
    from raystream.cuda.bvh.kernels import lay_out

    nodes = lay_out(structure, "binary").arrays["nodes"]
    frame = structure.frame
    origins = (rays.origins[order].astype(np.float64) - frame.center) * frame.scale
    directions = rays.directions[order].astype(np.float64) * frame.scale
    ends = np.minimum(t.ravel(), rays.t_max)[order].astype(np.float64)
    with np.errstate(divide="ignore"):
        found = visits(nodes, nodes.view(np.int32), origins, 1.0 / directions, ends)
    return [float(one.mean()) for one in found]


def counts_of(tracer, name, query, rays):
    """A row for each order."""
    structure = tracer.structure
    nodes, tests = met_by(structure, query, rays)
    t = tracer.first_hit(rays.origins, rays.directions, t_max=rays.t_max).t
    shuffled = np.random.default_rng(len(name)).permutation(len(rays))
    keys = keys_of(structure, rays)
    orders = {
        "given": np.arange(len(rays)),
        "shuffled": shuffled,
        "sorted": shuffled[np.argsort(keys[shuffled], kind="stable")],
    }
    for label, order in orders.items():
        own = nodes[order], tests[order]
        longest, every = must_visit(structure, rays, t, order)
        yield {
            "set": name,
            "order": label,
            "rays": len(rays),
            "nodes": float(nodes.mean()),
            "tests": float(tests.mean()),
            "lanes": lanes_used(*own),
            "blocks": blocks_used(turns_of(*own)),
            "refilled": lanes_refilled((own[0] + own[1]).astype(np.int64), LEAST_LANES),
            "longest": longest,
            "all": every,
        }


def print_counts(scene, row):
    shares = "".join(f"{row[key]:>10.2f}" for key in ("lanes", "blocks", "refilled"))
    print(
        f"{scene:14}{row['set']:9}{row['order']:10}{row['rays']:>9,}{row['nodes']:>8.1f}"
        f"{row['tests']:>8.1f}{shares}{row['longest']:>9.1f}{row['all']:>9.1f}",
        flush=True,
    )


COUNT_TITLES = (
    f"{'scene':14}{'set':9}{'order':10}{'rays':>9}{'nodes':>8}{'tests':>8}"
    f"{'lanes':>10}{'blocks':>10}{'refilled':>10}{'longest':>9}{'all':>9}"
)


def count(name, scene, arguments):
    """Counts of a scene."""
    tracer = rs.Tracer(scene)
    for set_name, query, parts in cuda_speed.ray_sets(scene, tracer, *arguments):
        for row in counts_of(tracer, set_name, query, joined(parts)):
            print_counts(name, row)
            yield row


def joined(parts):
    """All rays of a set."""
    parts = list(parts)
    columns = (np.concatenate([getattr(one, key) for one in parts]) for key in Rays._fields[:2])
    return Rays(*columns, parts[0].t_max)


# ---- Rates.


def rate(name, scene, ways, repeats, arguments):
    """Rates of a scene."""
    found = {"scene": name, "triangles": len(scene.triangles), "absent": {}, "builds": {}}
    turns = []
    for word, contender in ((word, cuda_speed.Ours(word, scene, [])) for word in ways):
        contender._others = [one.contender for one in turns]
        contender.build(None)
        turns.append(cuda_speed.Turn(word, contender))
        found["builds"][word] = 0.0
    tracer = turns[0].contender.tracer
    for set_name, query, parts in cuda_speed.ray_sets(scene, tracer, *arguments):
        parts = list(parts)
        for label in ("given", "shuffled"):
            given = parts if label == "given" else map(shuffled_part, parts)
            for row in cuda_speed.trace_set(set_name, query, given, turns, repeats):
                row["rays_come"] = label
                print(f"{label:10}{cuda_speed.line_of(found, row)}", flush=True)
                yield row


def shuffled_part(rays):
    order = np.random.default_rng(len(rays)).permutation(len(rays))
    return Rays(rays.origins[order], rays.directions[order], rays.t_max)


def has_gpu():
    """Whether there is a GPU that is not simulated."""
    try:
        from raystream.jit.cuda import CudaError, is_simulated, open_gpu
    except ImportError:
        sys.exit("numba-cuda: not found; pip install 'raystream[cuda]'")
    try:
        open_gpu()
    except CudaError:
        return False
    return not is_simulated()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", default=["sponza", "conference"])
    parser.add_argument("--size", default="256x192", help="of the picture of primary rays")
    parser.add_argument("--per-hit", type=int, default=4)
    parser.add_argument("--way", action="append", help="STRUCTURE[:KEY=VALUE,...], for rates")
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--part", type=int, default=cuda_speed.PART)
    asked = parser.add_mutually_exclusive_group()
    asked.add_argument("--counts", action="store_true", help="even with a GPU")
    asked.add_argument("--rates", action="store_true", help="even in the simulator")
    parser.add_argument("--json", type=Path, help="file for the figures, written after each scene")
    chosen = parser.parse_args()
    width, _, height = chosen.size.partition("x")
    arguments = (int(width), int(height)), chosen.per_hit, chosen.part
    measures_rates = chosen.rates or (has_gpu() and not chosen.counts)
    kept = {"counts": [], "rates": []}
    print(f"{'rays come':10}{cuda_speed.TITLES}" if measures_rates else COUNT_TITLES)
    for name in chosen.scenes:
        scene = rs.load(name)
        if measures_rates:
            rows = rate(name, scene, chosen.way or WAYS, chosen.repeats, arguments)
        else:
            rows = count(name, scene, arguments)
        kept["rates" if measures_rates else "counts"].append({"scene": name, "rows": list(rows)})
        if chosen.json:
            chosen.json.write_text(json.dumps(kept, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
