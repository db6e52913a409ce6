"""Scene statistics v, t and s, and their sensitivity (Purcell 2002, Figure 6)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from raystream.rendering.heatmap import heatmap
from raystream.rendering.render import render
from raystream.scene.camera import Camera
from raystream_lab.cameras import orbit, turn
from raystream_lab.published import published
from raystream_lab.purcell.grid_resolution import resolution_sweep
from raystream_lab.purcell.image_counts import (
    SIZE,
    ImageCounts,
    count_image,
    grid_of,
    grid_options,
    grid_tracer,
)
from raystream_lab.results import (
    NOT_EXPLAINED,
    Cell,
    Claim,
    ReportImage,
    Result,
    Table,
    comparison,
    is_near,
)
from raystream_lab.runner import Runner
from raystream_lab.views import PURCELL_VIEWS, View

#: The statistics of Figure 6.
STATISTICS = {
    "v": "cells per ray (v)",
    "t": "triangles per ray (t)",
    "s": "share of rays that hit (s)",
}

#: Measured but not judged: the paper's grid shows that its bunny had a floor.
_ALONE = "bunny"

#: Not judged, since the camera was chosen by it.
_CHOSEN_BY = ("bunny on a floor", "s")

#: Image size for other cameras.
_SWEEP_SIZE = 128

#: Size of the report's images.
_IMAGE_SIZE = 240


def paper_view(view: str) -> str:
    """The name of the published figures of a view: the paper has one bunny."""
    return "bunny" if view.startswith("bunny") else view


def image_statistics(runner: Runner, name: str) -> ImageCounts:
    """v, t, s and maxima of a view on Purcell's grid; measured once per run."""
    size = runner.size(SIZE)

    def measure() -> ImageCounts:
        view = runner.view(name)
        return count_image(grid_tracer(runner, view), view, size)

    values: ImageCounts = runner.measure(f"{name}, {size} x {size}", measure, shared=True)
    return values


def scene_statistics(runner: Runner) -> Result:
    """Figure 6, the grids of section 4.1, and the sensitivity to the camera."""
    result = Result()
    figure: list[tuple[str, Cell, Cell, str]] = []
    grids: list[list[Cell]] = []
    sweeps: list[list[Cell]] = []
    judged: dict[str, bool] = {}
    reasons: dict[str, str] = {}
    for name, view in result.available(PURCELL_VIEWS, runner.view):
        ours = image_statistics(runner, name)
        sweep, resolutions = camera_sweep(runner, view), resolution_sweep(runner, view)
        theirs = published("purcell", "figure 6").values[paper_view(name)]
        why = joint_reason(theirs, {"camera": sweep, "grid": _by_grid(resolutions)})
        for key, what in STATISTICS.items():
            near = is_near(ours[key], theirs[key])
            told = _explain(name, key, "" if near else why)
            if name != _ALONE and (name, key) != _CHOSEN_BY:
                judged[f"{name}, {key}"] = near
                reasons[f"{name}, {key}"] = told
            figure.append((f"{name}: {what}", theirs[key], ours[key], told))
        grids.append(_grid_row(runner, view))
        sweeps += _sweep_rows(name, theirs, sweep)
        result.images += _images(runner, view)
    source = published("purcell", "figure 6").source
    size = runner.size(SIZE)
    result.tables = [
        comparison(
            "purcell-figure-6",
            f"Cells, triangles and hits per ray: {source}; {size} x {size} rays",
            figure,
            *_notes(runner),
        ),
        Table.of(
            "purcell-grids",
            "Scenes and their grids",
            ["view", "triangles", "published", "cells", "published cells", "filled", "description"],
            grids,
            _soda_hall(),
        ),
        Table.of(
            "purcell-cameras",
            f"The same scenes from other cameras, {_SWEEP_SIZE} x {_SWEEP_SIZE} rays",
            ["view", "cameras", "figure", "published", "least", "median", "most", "nearest camera"],
            sweeps,
            "Nearest: the camera whose v, t and s are nearest to the published ones, by the "
            "largest of their deviations; its value is in brackets.",
        ),
    ]
    result.claims = [
        Claim.judged(
            "v, t and s agree with Figure 6 within a quarter",
            source,
            judged,
            "; ".join(f"not {case} ({reasons[case]})" for case, held in judged.items() if not held)
            or f"all of {len(judged)}",
        )
    ]
    return result


def joint_reason(
    theirs: Mapping[str, float], tried: Mapping[str, Mapping[str, Mapping[str, float]]]
) -> str:
    """A single change that brings v, t and s near the published values, all three at once.

    Parameters
    ----------
    theirs : mapping of str to float
        The published values.
    tried : mapping of str to mapping
        By what is changed, such as ``"camera"``, and by its new value: v, t and s.

    Returns
    -------
    str
        The nearest such change, or that the difference is not explained, with the nearest of all.
    """
    found = {f"{what}: {name}": one for what, each in tried.items() for name, one in each.items()}
    nearest = min(found, key=lambda name: _distance(found[name], theirs))
    values = ", ".join(f"{key} {found[nearest][key]:.3g}" for key in STATISTICS)
    if all(is_near(found[nearest][key], theirs[key]) for key in STATISTICS):
        return f"{nearest} gives {values}"
    return f"{NOT_EXPLAINED}: none of {len(found)} changes gives all three; nearest {values}"


def _by_grid(resolutions: Mapping[int, ImageCounts]) -> dict[str, ImageCounts]:
    return {f"{least} cells along the shortest axis": one for least, one in resolutions.items()}


def _explain(name: str, key: str, why: str) -> str:
    if name == _ALONE:
        return "not the paper's scene: its grid differs"
    return "the camera was chosen by this share" if (name, key) == _CHOSEN_BY else why


def _soda_hall() -> str:
    """Why the paper's printed grid of Soda Hall cannot be right."""
    grids = published("purcell", "grids").values
    cells, least = grids["building"], grids["min_resolution"]["building"]
    longest = published("purcell", "table 2").values["building outside"]["most_steps"]
    return (
        "The paper also prints the bunny's grid for Soda Hall, which cannot be right: its "
        f"shortest axis should have {least} cells, and Table 2 has a ray of {longest} steps, while "
        f"a grid of {' x '.join(map(str, cells))} allows at most {sum(cells) - 2}."
    )


def _notes(runner: Runner) -> list[str]:
    about = (
        "Soda Hall and the forest are replaced by substitutes, whose figures show only whether "
        "ours are plausible, not whether they are right. The paper's cameras are not known."
    )
    notes = [about]
    if runner.quick:
        notes.append("Quick: small scenes, grids and images; not comparable.")
    return notes


def other_cameras(view: View) -> Iterator[tuple[str, Camera]]:
    """Other cameras for a view: orbiting it, or at other positions inside."""
    if "inside" in view.name:
        return turn(view.camera, range(0, 360, 45), (0.0, 0.4, 0.8))
    heights = (55.0, 70.0, 88.0) if "top" in view.name else (10.0, 35.0, 60.0)
    return orbit(view.camera, view.scene.up, range(0, 360, 60), heights, (0.6, 0.8, 1.0, 1.3))


def camera_sweep(runner: Runner, view: View) -> dict[str, ImageCounts]:
    """Counts of other cameras in a view's scene, on the same grid."""
    size = _SWEEP_SIZE // 2 if runner.quick else _SWEEP_SIZE

    def measure() -> dict[str, ImageCounts]:
        tracer = grid_tracer(runner, view)
        return {
            name: count_image(tracer, view.seen_from(camera, name), size)
            for name, camera in other_cameras(view)
        }

    sweep: dict[str, ImageCounts] = runner.measure(
        f"{view.name}, other cameras, {size} x {size}", measure, shared=True
    )
    return sweep


def _sweep_rows(
    name: str, theirs: dict[str, float], sweep: dict[str, ImageCounts]
) -> Iterator[list[Cell]]:
    nearest = min(sweep, key=lambda camera: _distance(sweep[camera], theirs))
    for key, what in STATISTICS.items():
        values = sorted(one[key] for one in sweep.values())
        yield [
            name,
            len(sweep),
            what,
            theirs[key],
            values[0],
            values[len(values) // 2],
            values[-1],
            f"{nearest} ({sweep[nearest][key]:.3g})",
        ]


def _distance(ours: Mapping[str, float], theirs: Mapping[str, float]) -> float:
    """The largest relative deviation from the published values."""
    return max(abs(ours[key] / theirs[key] - 1.0) for key in STATISTICS)


def _grid_row(runner: Runner, view: View) -> list[Cell]:
    def measure() -> dict[str, Any]:
        grid = grid_of(grid_tracer(runner, view))
        cells = [int(count) for count in grid.lattice.counts]
        return {"cells": cells, "filled": 1.0 - grid.quality()["empty share"]}

    values = runner.measure(f"{view.name}, grid", measure)
    paper = paper_view(view.name).split()[0]
    cells = values["cells"]
    return [
        view.name,
        view.scene.triangle_count,
        published("purcell", "triangles").values[paper],
        " x ".join(map(str, cells)),
        " x ".join(map(str, published("purcell", "grids").values[paper])),
        values["filled"],
        view.about,
    ]


def _images(runner: Runner, view: View) -> Iterator[ReportImage]:
    """Images of the view, and heat maps of its steps and tests."""
    size = (_IMAGE_SIZE,) * 2
    path = runner.folder / f"{view.name.replace(' ', '_')}.png"
    if not path.exists():
        render(view.scene, "raycast", size=size, camera=view.camera).save(path)
    yield ReportImage(f"{view.name}: {grid_text(view, runner.quick)}", path)
    for what in () if runner.quick else ("steps", "tests"):
        path = runner.folder / f"{view.name.replace(' ', '_')}_{what}.png"
        if not path.exists():
            heatmap(grid_tracer(runner, view), what, size, camera=view.camera).save(path)
        yield ReportImage(f"{view.name}: {what} per ray", path)


def grid_text(view: View, quick: bool) -> str:
    """The options of a view's grid as text."""
    return ", ".join(f"{name} {value}" for name, value in grid_options(view, quick).items())
