"""Figure 6 and Table 2 with lists of exactly the triangles in a cell (Purcell 2002).

The engine's cells list triangles whose box and plane overlap them, so that every structure has the
bits of brute force (docs/decisions/0010-grid). The paper's, as any of its time, list the triangles
themselves: ``Grid(overlap="exact")``. What that guarantee costs is measured here.
"""

from __future__ import annotations

from raystream_lab.published import published
from raystream_lab.purcell.image_counts import SIZE, count_image, grid_of, grid_options, grid_tracer
from raystream_lab.purcell.scene_statistics import STATISTICS, paper_view
from raystream_lab.results import Cell, Claim, Result, Table, is_near
from raystream_lab.runner import Runner
from raystream_lab.views import PURCELL_VIEWS
from raystream_lab.walks import record, replay

#: Figures of Table 2, by our names.
_SCHEDULE = {
    "passes": ("passes", "total"),
    "traverse": ("traversal passes", "traversal"),
    "intersect": ("intersection passes", "intersection"),
    "most_steps": ("most steps of a ray", "most_steps"),
    "most_tests": ("most tests of a ray", "most_tests"),
    "efficiency": ("SIMD efficiency", "efficiency"),
}

_COLUMNS = ("quantity", "published", "planes", "exact", "planes / published", "exact / published")

#: Not judged: its grid shows that it is not the paper's scene.
_ALONE = "bunny"

Lists = dict[str, dict[str, float]]


def measure_lists(runner: Runner, name: str) -> Lists:
    """Counts and passes of a view with either overlap, and the lengths of lists.

    Returns
    -------
    dict of str to dict of str to float
        By overlap: ``v``, ``t``, ``s``; ``references``; the figures of Table 2.
    """
    size = runner.size(SIZE)

    def measure() -> Lists:
        view = runner.view(name)
        found = {}
        for overlap in ("plane", "exact"):
            options = {**grid_options(view, runner.quick), "overlap": overlap}
            tracer = grid_tracer(runner, view, **options)
            values = count_image(tracer, view, size)
            usual = replay(record(tracer, *view.rays(size), progress=runner.progress))
            found[overlap] = {
                **values,
                "references": float(len(grid_of(tracer).lists.references)),
                "passes": float(len(usual)),
                "traverse": float(usual.passes["traverse"]),
                "intersect": float(usual.passes["intersect"]),
                "efficiency": usual.efficiency,
            }
        return found

    measured: Lists = runner.measure(f"{name}, both lists, {size} x {size}", measure)
    return measured


def exact_lists(runner: Runner) -> Result:
    """Figure 6, Table 2 and the lengths of lists, with planes and with exact overlap."""
    result = Result()
    found = dict(result.available(PURCELL_VIEWS, lambda name: measure_lists(runner, name)))
    figure: list[list[Cell]] = []
    table: list[list[Cell]] = []
    for name, each in found.items():
        theirs = published("purcell", "figure 6").values[paper_view(name)]
        figure += [
            _row(f"{name}: {what}", theirs[key], each, key) for key, what in STATISTICS.items()
        ]
        theirs = published("purcell", "table 2").values[paper_view(name)]
        table += [
            _row(f"{name}: {what}", theirs[key], each, own)
            for own, (what, key) in _SCHEDULE.items()
        ]
    size = runner.size(SIZE)
    sources = published("purcell", "figure 6").source, published("purcell", "table 2").source
    result.tables = [
        Table.of("purcell-lists", "The price of equal bits: lengths of lists", *_prices(found)),
        Table.of(
            "purcell-lists-figure-6",
            f"Cells, triangles and hits per ray by overlap: {sources[0]}; {size} x {size} rays",
            _COLUMNS,
            figure,
            _near_note(figure),
        ),
        Table.of(
            "purcell-lists-table-2",
            f"Passes by overlap: {sources[1]}; threshold 20 %, {size} x {size}",
            _COLUMNS,
            table,
            _near_note(table),
        ),
    ]
    result.claims = [
        _claim("v, t and s agree with Figure 6 within a quarter, with exact lists", figure, 0),
        _claim("Passes agree with Table 2 within a quarter, with exact lists", table, 1),
    ]
    return result


def _row(what: str, theirs: float, each: Lists, key: str) -> list[Cell]:
    plane, exact = each["plane"][key], each["exact"][key]
    return [what, theirs, plane, exact, plane / theirs, exact / theirs]


def _prices(found: dict[str, Lists]) -> tuple[list[str], list[list[Cell]], str]:
    rows: list[list[Cell]] = []
    for name, each in found.items():
        plane, exact = each["plane"], each["exact"]
        longer = [
            plane[key] / exact[key] - 1.0 if exact[key] else None for key in ("references", "t")
        ]
        rows.append([name, int(plane["references"]), int(exact["references"]), *longer])
    columns = ["view", "references, planes", "references, exact", "longer by", "more tests by"]
    return (
        columns,
        rows,
        (
            "Planes: cells list the triangles whose box and plane overlap them, as by default. "
            "Exact: cells list only the triangles that overlap them, by a test of 13 separating "
            "axes, without a guarantee for rays that graze an edge."
        ),
    )


def _is_near(ratio: Cell) -> bool:
    return isinstance(ratio, int | float) and is_near(ratio, 1.0)


def _counted(rows: list[list[Cell]]) -> list[list[Cell]]:
    return [row for row in rows if not str(row[0]).startswith(f"{_ALONE}:")]


def _near_note(rows: list[list[Cell]]) -> str:
    counted = _counted(rows)
    before, after = (sum(_is_near(row[k]) for row in counted) for k in (4, 5))
    return (
        f"Within a quarter of the published values: {before} of {len(counted)} with planes, "
        f"{after} of {len(counted)} with exact lists (the bunny without a floor is not counted)."
    )


def _claim(text: str, rows: list[list[Cell]], which: int) -> Claim:
    source = published("purcell", ("figure 6", "table 2")[which]).source
    cases = {str(row[0]): _is_near(row[5]) for row in _counted(rows)}
    return Claim.judged(text, source, cases, _near_note(rows))
