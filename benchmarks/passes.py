"""How many passes the multipass machine takes, and the states of rays in kd-trees.

    python benchmarks/passes.py --size 512 --scenes bunny bart_robots

Prints the tables of docs/machines.rst, for first hits of each scene's camera rays: the passes of
each scheduler compared with the minimum (Purcell 2002, Table 2), and how often rays were in each
state of the three kd-tree traversals (Foley 2005, Table 2).
"""

import argparse
import time

import raystream as rs

SCENES = ("bunny", "kitchen", "bart_robots", "sponza")
SCHEDULERS = ("naive", "threshold", "most-work", "double")
GRIDS = {"grid": {"resolution": 50}, "kdtree": {"traversal": "backtrack", "layout": "foley"}}


def table(title, columns, rows):
    """Print a table as reStructuredText."""
    cells = [columns, *[[str(cell) for cell in row] for row in rows]]
    widths = [max(len(row[k]) for row in cells) for k in range(len(columns))]
    rule = " ".join("=" * width for width in widths)
    print(f"\n.. table:: {title}\n")
    for k, row in enumerate(cells):
        if k < 2:
            print(f"   {rule}")
        print("   " + " ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)))
    print(f"   {rule}", flush=True)


def first_hits(scene, size, structure, **options):
    """The counters of a scene's camera rays, and the seconds taken."""
    tracer = rs.Tracer(scene, structure, counters=True, **options)
    origins, directions = scene.camera_for(1.0).rays(size, size)
    started = time.perf_counter()
    tracer.first_hit(origins, directions)
    return tracer.counters, time.perf_counter() - started


def scheduler_rows(name, scene, size, structure, options):
    """Yield a row for each scheduler."""
    for scheduler in SCHEDULERS:
        found, seconds = first_hits(
            scene, size, structure, machine="multipass", scheduler=scheduler, **options
        )
        passes = found.passes
        intersections = passes.of("intersect")
        yield [
            name,
            structure,
            scheduler,
            f"{len(passes):,}",
            f"{len(passes) - intersections:,}",
            f"{intersections:,}",
            f"{passes.optimal_count:,}",
            f"{len(passes) / passes.optimal_count:.2f}",
            f"{passes.efficiency:.1%}",
            f"{seconds:.1f}",
        ]


def unrolled_rows(name, scene, size):
    """Yield passes, and words read and written, with several steps per pass."""
    for steps, tests in ((1, 1), (4, 2), (8, 4), (16, 8)):
        for compaction in (False, True):
            found, seconds = first_hits(
                scene,
                size,
                "grid",
                resolution=50,
                machine="multipass",
                traversal_steps=steps,
                intersections=tests,
                compaction=compaction,
            )
            passes = found.passes
            words = sum(passes.counters.words_read.values())
            words += sum(passes.counters.words_written.values())
            yield [
                name,
                steps,
                tests,
                "yes" if compaction else "no",
                f"{len(passes):,}",
                f"{passes.efficiency:.1%}",
                f"{words / size**2:,.0f}",
                f"{seconds:.1f}",
            ]


def foley_rows(name, scene, size, cost):
    """Yield a row for each traversal of a kd-tree."""
    for traversal in ("stack", "restart", "backtrack"):
        found, _ = first_hits(
            scene, size, "kdtree", traversal=traversal, layout="foley", traversal_cost=cost
        )
        total = found.total
        yield [
            name,
            traversal,
            *(
                f"{total[key]:,}"
                for key in (
                    "steps",
                    "backtrack_steps",
                    "leaves",
                    "tests",
                    "restarts",
                    "backtracks",
                )
            ),
        ]


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--scenes", nargs="+", default=SCENES)
    arguments = parser.parse_args()
    schedules, unrolled, states = [], [], []
    for name in arguments.scenes:
        scene = rs.load(name)
        for structure, options in GRIDS.items():
            schedules += scheduler_rows(name, scene, arguments.size, structure, options)
        unrolled += unrolled_rows(name, scene, arguments.size)
        states += foley_rows(name, scene, arguments.size, 8.0)
    table(
        "Passes",
        ["scene", "structure", "scheduler", "passes", "others", "intersect", "optimal"]
        + ["ratio", "efficiency", "seconds"],
        schedules,
    )
    table(
        "Several steps per pass",
        ["scene", "steps", "tests", "compaction", "passes", "efficiency", "words/ray", "seconds"],
        unrolled,
    )
    table(
        "States of rays in kd-trees",
        ["scene", "traversal", "down", "up", "leaf", "triangles", "restarts", "backtracks"],
        states,
    )


if __name__ == "__main__":
    main()
