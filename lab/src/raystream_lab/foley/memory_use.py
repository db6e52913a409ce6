"""The bits of a node, and the working set of rays with and without a stack (sections 1, 3.1, 5)."""

from __future__ import annotations

from typing import Any

from raystream.machines.records import FOUND, RAY, WANTED
from raystream.machines.steps import steps_of
from raystream.structures.kdtree.structure import KdTreeStructure
from raystream_lab.foley.scenes import SCENES, SIZE, available_views, foley_tree
from raystream_lab.published import published
from raystream_lab.results import Cell, Claim, Result, Table, comparison, is_near, listed
from raystream_lab.runner import Runner
from raystream_lab.views import View

#: Bytes of a stack entry: a node and the end of its interval.
_ENTRY = 8

_FLOAT_BYTES = 4

Found = dict[str, Any]


def memory_use(runner: Runner) -> Result:
    """Memory of nodes and of rays."""
    result = Result()
    found: dict[str, Found] = {}
    names = ("cornell", "robots") if runner.quick else tuple(SCENES)
    for name, view in available_views(runner, names, result):
        found[name] = _measured(runner, name, view)
    if not found:
        return result
    result.tables = [_bit_table(found), _ray_table(found)]
    result.claims = _claims(found)
    return result


def _measured(runner: Runner, name: str, view: View) -> Found:
    def measure() -> Found:
        packed = foley_tree(view.scene, runner.progress)
        compact = foley_tree(view.scene, runner.progress, layout="compact")
        return {
            "depth": packed.quality()["depth"],
            "tree": sum(array.nbytes for array in packed.arrays.values()),
            "bits": node_bits(packed, compact),
            "bytes": {
                traversal: ray_bytes(packed.with_traversal(traversal))
                for traversal in ("stack", "restart", "backtrack", "short-stack")
            },
        }

    found: Found = runner.measure(name, measure)
    return found


def node_bits(packed: KdTreeStructure, compact: KdTreeStructure) -> dict[str, float]:
    """Bits per node of a tree in both layouts, and of an extended split.

    Parameters
    ----------
    packed, compact : KdTreeStructure
        The same tree with the layouts ``"foley"`` and ``"compact"``, for backtracking.

    Returns
    -------
    dict of str to float
        ``node``, ``cpu_node``, ``extended``.
    """
    count = len(compact.tree.nodes)
    own = packed.arrays["nodes"].nbytes + packed.arrays["leaves"].nbytes
    extended = packed.arrays["extended"]
    return {
        "node": 8 * own / count,
        "cpu_node": 8 * compact.arrays["nodes"].nbytes / count,
        "extended": 8 * extended.nbytes / len(extended),
    }


def ray_bytes(tree: KdTreeStructure) -> dict[str, int]:
    """Bytes of a ray on the multipass machine: its ``state`` and its ``stack``.

    The state is the ray, its goal, its hits so far, its place in the tree and the kernel it waits
    for.
    """
    steps = steps_of(tree)
    others = RAY.itemsize + WANTED.itemsize + FOUND.itemsize + 1
    return {"state": others + steps.place.itemsize, "stack": steps.stack_bytes}


def _bit_table(found: dict[str, Found]) -> Table:
    source = published("foley", "bits")
    titles = {
        "node": "a node, with two pointers",
        "cpu_node": "a node of CPU trees",
        "extended": "more per split, for backtracking",
    }
    rows: list[tuple[str, Cell, Cell, str]] = [
        (f"{name}: {title}", source.values[key], one["bits"][key], "")
        for name, one in found.items()
        for key, title in titles.items()
    ]
    return comparison("foley-bits", f"Bits of a node: {source.source}", rows)


def _ray_table(found: dict[str, Found]) -> Table:
    card = published("foley", "card").values["megabytes"] * 2**20
    state = published("foley", "state")
    floats = state.values["floats"]
    rows: list[list[Cell]] = []
    for name, one in found.items():
        for traversal, own in one["bytes"].items():
            total = own["state"] + own["stack"]
            rows.append(
                [name, traversal, one["depth"], own["state"], own["stack"]]
                + [SIZE**2 * total / 2**20, (card - one["tree"]) / total / 1e6]
            )
        needed = one["bytes"]["stack"]["state"] + _needed(one)
        rows.append(
            [name, "stack, of this tree's depth", one["depth"], needed - _needed(one)]
            + [_needed(one), SIZE**2 * needed / 2**20, (card - one["tree"]) / needed / 1e6]
        )
    return Table.of(
        "foley-working-set",
        "Memory of rays on the multipass machine, with and without a stack: Foley 2005, sections 1 "
        "and 5",
        ["scene", "traversal", "depth", "bytes of state per ray", "bytes of stack per ray"]
        + [f"MB for {SIZE} x {SIZE} rays", f"million rays in {card >> 20} MB"],
        rows,
        "Our stacks have room for the deepest tree that can be built; a stack of this tree's depth "
        f"has {_ENTRY} bytes per split of the longest path. State: the ray itself, its goal, its "
        f"hit, its place in the tree. The paper's packed state has {floats} floats, "
        f"{floats * _FLOAT_BYTES} bytes, without the ray ({state.place}).",
        "Million rays: those that fit in the memory of the paper's card together with the tree.",
    )


def _needed(one: Found) -> int:
    """Bytes of a stack for the tree's depth."""
    return _ENTRY * (int(one["depth"]) + 1)


def _claims(found: dict[str, Found]) -> list[Claim]:
    bits = published("foley", "bits")
    own = {name: one["bits"] for name, one in found.items()}
    state = 4 * published("foley", "state").values["floats"]
    shares = {
        f"{name}, {kind}": (bytes_ + _needed(one)) / bytes_
        for name, one in found.items()
        for kind, bytes_ in (("our state", one["bytes"]["restart"]["state"]), ("paper's", state))
    }
    return [
        Claim.judged(
            "A node takes 96 bits, 64 on CPUs, and another 256 per split for backtracking",
            bits.source,
            {
                f"{name}, {key}": is_near(value, bits.values[key])
                for name, each in own.items()
                for key, value in each.items()
            },
            "; ".join(f"{name}: {listed(each, '.4g')}" for name, each in own.items()),
        ),
        Claim.judged(
            "Without a stack, the working set of a ray is smaller, so that more rays are traced at "
            "once (read as: with a stack of the tree's depth it is at least twice as large)",
            "Foley 2005, sections 1 and 5",
            {case: ratio >= 2.0 for case, ratio in shares.items()},
            "bytes of a ray with a stack over those without: " + listed(shares),
        ),
    ]
