"""Instructions and words of our own compiled kernels, compared with Table 1 (Purcell 2002, 3.2)."""

from __future__ import annotations

from typing import Any

from raystream.scene.procedural.cornell import cornell
from raystream.structures.grid.structure import GridStructure
from raystream.tracer import Tracer
from raystream_lab.as_published.grid_kernels import grid_steps
from raystream_lab.cost_model import ARCHITECTURES, Prices, prices
from raystream_lab.kernels.costs import KernelCost, cost_of, kernel_costs
from raystream_lab.published import published
from raystream_lab.results import TOLERANCE, Cell, Claim, Result, Table, listed
from raystream_lab.runner import Runner

#: Structures whose kernels are counted; their triangles do not matter.
COUNTED: dict[str, dict[str, Any]] = {
    "brute": {},
    "grid": {"resolution": 4},
    "kdtree": {"traversal": "backtrack", "layout": "foley"},
    "bvh": {},
    "graph": {},
}

#: Our kernels, and the corresponding rows of Table 1.
_ROWS = {
    ("grid", "set up"): "set up",
    ("grid", "traverse"): "step",
    ("grid", "intersect"): "intersect",
    ("brute", "intersect"): "intersect",
    ("as published", "set up"): "set up",
    ("as published", "traverse"): "step",
    ("as published", "intersect"): "intersect",
}

_COLUMNS = (
    "instructions",
    "Table 1",
    "a further step",
    "Table 1, branching",
    "processor's",
    "words in",
    "R",
    "words out",
    "W",
    "words of the scene",
    "M",
)


def cost_figures(runner: Runner, structure: str) -> list[dict[str, Any]]:
    """Costs of a structure's kernels, counted in their code; compiled once per run."""

    def measure() -> list[dict[str, Any]]:
        built = Tracer(cornell(), structure, **COUNTED[structure]).structure
        return [_figures(one) for one in kernel_costs(built)]

    found: list[dict[str, Any]] = runner.measure(f"kernels of {structure}", measure)
    return found


def published_figures(runner: Runner) -> list[dict[str, Any]]:
    """Costs of Purcell's kernels, with the words of the fields that they read and write."""

    def measure() -> list[dict[str, Any]]:
        built = Tracer(cornell(), "grid", **COUNTED["grid"]).structure
        assert isinstance(built, GridStructure)
        steps = grid_steps(built)
        costs = [cost_of(steps, number) for number in range(len(steps.kernels))]
        return [{**_figures(one), "in": one.used_in, "out": one.used_out} for one in costs]

    found: list[dict[str, Any]] = runner.measure("kernels as published", measure)
    return found


def _figures(one: KernelCost) -> dict[str, Any]:
    return {
        "kernel": one.kernel,
        "code": one.code.total,
        "loop": None if one.loop is None else one.loop.total,
        "machine": one.machine,
        "in": sum(one.words_in.values()),
        "out": sum(one.words_out.values()),
        "fetched": one.fetched_words,
    }


def compiled_kernels(runner: Runner) -> Result:
    """Count every kernel of every structure."""
    rows: list[list[Cell]] = []
    tables = prices("multipass"), prices("branching")
    for structure in ("grid",) if runner.quick else COUNTED:
        for one in cost_figures(runner, structure):
            row = _ROWS.get((structure, one["kernel"]))
            rows.append([f"{structure}: {one['kernel']}", *_cells(one, row, tables)])
    for one in published_figures(runner):
        row = _ROWS.get(("as published", one["kernel"]))
        rows.append([f"grid, as published: {one['kernel']}", *_cells(one, row, tables)])
    place = published("purcell", "table 1")
    own = {one["kernel"]: one for one in cost_figures(runner, "grid")}
    return Result(
        claims=_program_claims(own),
        tables=[
            Table.of(
                "purcell-kernels",
                f"Our compiled kernels and {place.source}",
                ["kernel", *_COLUMNS],
                rows,
                "Instructions: those of the optimised LLVM code of one step for one ray, which "
                "loads its state, computes and stores, over all branches. A further step: the part "
                "of them that another step in the same pass takes, next to the paper's branching "
                "kernel. Processor's: machine instructions of the same code. R, W and M: the words "
                "of Table 1, multipass.",
                "The paper's instructions work on vectors of 4 numbers, ours in grid and brute "
                "force on scalars. Our kernels set a ray up again in each pass, and our triangle "
                "test is watertight, with a float64 part for rays through an edge; the paper's "
                "test is Möller and Trumbore's. As published: the latter as printed in Figure 5, "
                "and a 3D-DDA that adds up distances (raystream_lab.as_published); words in and "
                "out are those of the fields that the code reads and writes.",
                "Words in and out: those of the whole records that a pass reads and writes. Words "
                "of the scene: those of all loads in the code; in grid and brute force, both parts "
                "of the triangle test load the same 9 words of vertices; trees test four triangles "
                "at a time.",
            )
        ],
    )


def _program_claims(own: dict[str, dict[str, Any]]) -> list[Claim]:
    """Judge the size of programs by Table 1 and by the grid's kernels."""
    limits = published("purcell", "programs")
    longest, words = limits.values["instructions"], 4 * limits.values["output_vectors"]
    lengths: dict[str, float] = {f"{kernel}, ours": one["code"] for kernel, one in own.items()}
    written: dict[str, float] = {f"{kernel}, ours": one["out"] for kernel, one in own.items()}
    for architecture in ARCHITECTURES:
        for kernel, row in published("purcell", "table 1").values[architecture].items():
            lengths[f"{kernel}, {architecture}"] = row["instructions"]
            written[f"{kernel}, {architecture}"] = row["written"]
    return [
        Claim.judged(
            f"The longest program has about {longest} instructions (read as: none has more than a "
            "quarter more)",
            limits.source,
            {name: count <= longest * (1.0 + TOLERANCE) for name, count in lengths.items()},
            listed(lengths, "g"),
        ),
        Claim.judged(
            f"A program writes at most two vectors, {words} words, in a pass",
            limits.source,
            {name: count <= words for name, count in written.items()},
            listed(written, "g") + "; the paper's set-up takes two passes",
        ),
    ]


def _cells(
    one: dict[str, Any], row: str | None, tables: tuple[dict[str, Prices], dict[str, Prices]]
) -> list[Cell]:
    multi, bare = (None, None) if row is None else (tables[0][row], tables[1][row])
    return [
        one["code"],
        multi and multi.instructions,
        one["loop"],
        bare and bare.instructions,
        one["machine"],
        one["in"],
        multi and multi.read,
        one["out"],
        multi and multi.written,
        one["fetched"],
        multi and multi.memory,
    ]
