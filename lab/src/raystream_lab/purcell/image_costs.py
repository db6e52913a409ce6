"""The cost of images on two architectures, by kernel and by kind of data (Figures 7 and 8)."""

from __future__ import annotations

from raystream_lab.cost_model import ARCHITECTURES, Cost, Counts, cost, prices
from raystream_lab.published import published
from raystream_lab.purcell.frame_rates import frame_claims, frame_table, second_marks
from raystream_lab.purcell.image_counts import SIZE, counts_of
from raystream_lab.purcell.scene_statistics import image_statistics, paper_view
from raystream_lab.purcell.schedules import image_schedule
from raystream_lab.results import Cell, Claim, Plot, Result, Series, Table
from raystream_lab.runner import Runner
from raystream_lab.views import PURCELL_VIEWS

#: Parts of Figure 7, and their kernels.
_PARTS = {
    "rays and set-up": ("generate eye ray", "set up"),
    "traversal": ("step",),
    "intersection": ("intersect",),
    "shading": ("color",),
    "stencil of passes": ("passes",),
}

_KINDS = ("stencil", "state", "data")

#: By view and architecture.
Costs = dict[tuple[str, str], Cost]


def image_costs(runner: Runner) -> Result:
    """Apply Table 1 to the measured images, and to the published statistics."""
    result = Result()
    ours: Costs = {}
    theirs: Costs = {}
    for name, values in result.available(
        PURCELL_VIEWS, lambda name: image_statistics(runner, name)
    ):
        passes = image_schedule(runner, name)["passes"]
        paper = paper_view(name)
        figure = published("purcell", "figure 6").values[paper]
        printed = published("purcell", "table 2").values[paper]["total"]
        rays = SIZE * SIZE
        for architecture in ARCHITECTURES:
            table = prices(architecture)
            is_multipass = architecture == "multipass"
            ours[name, architecture] = cost(counts_of(values, passes if is_multipass else 0), table)
            steps, tests, shadings = (round(rays * figure[key]) for key in ("v", "t", "s"))
            published_counts = Counts(
                rays, rays, steps, tests, shadings, printed if is_multipass else 0
            )
            theirs[name, architecture] = cost(published_counts, table)
    names = list(dict.fromkeys(name for name, _ in ours))
    size = runner.size(SIZE)
    result.tables = [
        _kernel_table(ours, theirs, size),
        _kind_table(ours, theirs, size),
        frame_table(ours, theirs, size),
    ]
    for architecture in ARCHITECTURES:
        result.plots += _plots(names, ours, architecture, (SIZE / size) ** 2)
    result.claims = [*_claims(names, ours), *frame_claims(ours, theirs)]
    result.notes.append(
        "Figures 7 and 8 are bar charts whose heights are not in our copy of the paper. The "
        "columns 'paper's counts' apply its Table 1 to its own v, t, s and passes."
    )
    return result


def _kernel_table(ours: Costs, theirs: Costs, size: int) -> Table:
    rows: list[list[Cell]] = []
    for (name, architecture), found in ours.items():
        printed, bytes_by_kernel = theirs[name, architecture], found.bytes_by_kernel
        for part, kernels in _PARTS.items():
            instructions = sum(found.instructions.get(one, 0.0) for one in kernels)
            moved = sum(bytes_by_kernel.get(one, 0.0) for one in kernels)
            if not instructions and not moved:
                continue
            rows.append(
                [
                    name,
                    architecture,
                    part,
                    instructions / found.all_instructions,
                    _share(printed.instructions, kernels, printed.all_instructions),
                    moved / found.all_bytes,
                    _share(printed.bytes_by_kernel, kernels, printed.all_bytes),
                ]
            )
        rays = size * size
        rows.append(
            [
                name,
                architecture,
                "all, per ray",
                found.all_instructions / rays,
                printed.all_instructions / SIZE**2,
                found.all_bytes / rays,
                printed.all_bytes / SIZE**2,
            ]
        )
    return Table.of(
        "purcell-figure-7",
        f"Instructions and bytes by kernel (Figure 7): shares, and sums per ray; {size} x {size}",
        [
            "view",
            "architecture",
            "kernel",
            "instructions",
            "instructions, paper's counts",
            "bytes",
            "bytes, paper's counts",
        ],
        rows,
    )


def _share(parts: dict[str, float], kernels: tuple[str, ...], whole: float) -> float:
    return sum(parts.get(one, 0.0) for one in kernels) / whole


def _by_kind(found: Cost) -> dict[str, float]:
    parts = (found.stencil, found.state, found.data)
    return {kind: sum(part.values()) for kind, part in zip(_KINDS, parts, strict=True)}


def _kind_table(ours: Costs, theirs: Costs, size: int) -> Table:
    rows: list[list[Cell]] = []
    for (name, architecture), found in ours.items():
        printed, kinds = theirs[name, architecture], _by_kind(found)
        printed_kinds = _by_kind(printed)
        rows.append(
            [
                name,
                architecture,
                *(
                    share
                    for kind in _KINDS
                    for share in (
                        kinds[kind] / found.all_bytes,
                        printed_kinds[kind] / printed.all_bytes,
                    )
                ),
                found.all_bytes / size**2,
            ]
        )
    columns = [title for kind in _KINDS for title in (kind, f"{kind}, paper's counts")]
    return Table.of(
        "purcell-figure-8",
        f"Bytes by kind of data (Figure 8): shares; {size} x {size}",
        ["view", "architecture", *columns, "bytes per ray"],
        rows,
        "State: that of rays between passes, and the pixel's colour. Data: the grid, lists, "
        "triangles, and what shading reads.",
    )


def _plots(names: list[str], ours: Costs, architecture: str, scale: float) -> list[Plot]:
    """Plots of an image of the paper's size: `scale` times the pixels that were traced."""
    billions = scale / 1e9
    found = {name: ours[name, architecture] for name in names}
    by_kernel = [
        Series(
            part,
            names,
            [
                billions * sum(found[name].bytes_by_kernel.get(one, 0.0) for one in kernels)
                for name in names
            ],
        )
        for part, kernels in _PARTS.items()
    ]
    compute = [
        Series(
            part,
            names,
            [
                billions * sum(found[name].instructions.get(one, 0.0) for one in kernels)
                for name in names
            ],
        )
        for part, kernels in list(_PARTS.items())[:-1]
    ]
    kinds = [
        Series(kind, names, [billions * _by_kind(found[name])[kind] for name in names])
        for kind in _KINDS
    ]
    return [
        Plot(
            f"purcell-figure-7-instructions-{architecture}",
            f"Figure 7, {architecture}: instructions of an image",
            "",
            "billions",
            compute,
            "stacked",
            marks=second_marks("instructions"),
        ),
        Plot(
            f"purcell-figure-7-bytes-{architecture}",
            f"Figure 7, {architecture}: bytes of an image, by kernel",
            "",
            "GB",
            by_kernel,
            "stacked",
            marks=second_marks("bytes"),
        ),
        Plot(
            f"purcell-figure-8-{architecture}",
            f"Figure 8, {architecture}: bytes of an image, by kind of data",
            "",
            "GB",
            kinds,
            "stacked",
        ),
    ]


def _claims(names: list[str], ours: Costs) -> list[Claim]:
    place = "Purcell 2002, section 4"
    core, state, data, gain = {}, {}, {}, {}
    shares = []
    evidence: dict[str, list[str]] = {"state": [], "data": [], "gain": []}
    for name in names:
        for architecture in ARCHITECTURES:
            found = ours[name, architecture]
            loops = found.instructions["step"] + found.instructions["intersect"]
            share = loops / found.all_instructions
            core[f"{name}, {architecture}"] = share > 0.5
            shares.append(share)
        kinds = _by_kind(ours[name, "multipass"])
        state[name] = kinds["state"] == max(kinds.values())
        evidence["state"].append(f"{name} {kinds['state'] / sum(kinds.values()):.0%}")
        kinds = _by_kind(ours[name, "branching"])
        data[name] = kinds["data"] == max(kinds.values())
        evidence["data"].append(f"{name} {kinds['data'] / sum(kinds.values()):.0%}")
        ratio = ours[name, "multipass"].all_bytes / ours[name, "branching"].all_bytes
        gain[name] = ratio > 2.0
        evidence["gain"].append(f"{name} {ratio:.1f}")
    return [
        Claim.judged(
            "Traversal and intersection dominate the instructions, on both architectures",
            f"{place}.1",
            core,
            f"shares from {min(shares, default=0.0):.0%} to {max(shares, default=0.0):.0%}",
        ),
        Claim.judged(
            "Multipass spends most of its bandwidth on ray state between passes",
            f"{place}.2",
            state,
            "share of state: " + ", ".join(evidence["state"]),
        ),
        Claim.judged(
            "Branching spends its bandwidth on reading data structures",
            f"{place}.2",
            data,
            "share of data: " + ", ".join(evidence["data"]),
        ),
        Claim.judged(
            "Branching needs significantly less bandwidth than multipass (here: less than half)",
            "Purcell 2002, sections 1 and 4.2",
            gain,
            "multipass over branching: " + ", ".join(evidence["gain"]),
        ),
    ]
