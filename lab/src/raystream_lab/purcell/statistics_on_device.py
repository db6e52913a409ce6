"""Scene statistics v, t and s, counted by a device (Purcell 2002, Figure 6)."""

from __future__ import annotations

from raystream.tracer import Tracer
from raystream_lab.agreement import Row, agreement_claim, agreement_table
from raystream_lab.published import published
from raystream_lab.purcell.image_counts import SIZE, ImageCounts, count_image, grid_options
from raystream_lab.purcell.scene_statistics import STATISTICS, paper_view
from raystream_lab.results import Cell, Result, comparison, is_near
from raystream_lab.runner import Runner
from raystream_lab.views import PURCELL_VIEWS

#: Counts that are compared with the CPU's.
_COUNTED = (*STATISTICS, "entering", "most_steps", "most_tests")


def statistics_on_device(runner: Runner) -> Result:
    """Figure 6 by the device's counters, and by the CPU's for the same rays."""
    result = Result()
    figure: list[tuple[str, Cell, Cell, str]] = []
    counts: list[Row] = []
    size = runner.device_size(SIZE)
    views = PURCELL_VIEWS[::2] if runner.quick else PURCELL_VIEWS
    for name, (cpu, ours) in result.available(views, lambda name: _counted(runner, name, size)):
        theirs = published("purcell", "figure 6").values[paper_view(name)]
        for key, what in STATISTICS.items():
            is_like = is_near(ours[key], theirs[key])
            why = f"the CPU counts {cpu[key]:.4g}; for causes, see purcell-statistics on the CPU"
            figure.append((f"{name}: {what}", theirs[key], ours[key], "" if is_like else why))
        counts += [(f"{name}: {key.replace('_', ' ')}", cpu[key], ours[key]) for key in _COUNTED]
    source = published("purcell", "figure 6").source
    result.tables = [
        comparison(
            "purcell-figure-6",
            f"Cells, triangles and hits per ray: {source}; {size} x {size} rays",
            figure,
            runner.facts.note,
            "Counted by the device. Scenes and cameras are the CPU's, and so are the causes of "
            "differences from the paper: other models, and cameras that are not known.",
        ),
        agreement_table(
            "purcell-statistics",
            f"The device's counters against the CPU's, {size} x {size} rays",
            runner.device,
            counts,
        ),
    ]
    result.claims = [agreement_claim(runner.device, counts)] if counts else []
    return result


def _counted(runner: Runner, name: str, size: int) -> tuple[ImageCounts, ImageCounts]:
    """Counts on the CPU and on the device."""

    def measure() -> list[ImageCounts]:
        view = runner.view(name)
        grid = Tracer(view.scene, "grid", **grid_options(view, runner.quick)).structure
        return [
            count_image(Tracer.of_structure(grid, view.scene, device, counters=True), view, size)
            for device in ("cpu", runner.device)
        ]

    cpu, ours = runner.measure(f"{name}, {size} x {size}", measure)
    return cpu, ours
