"""Render modes vis, x-ray, ao and kajiya in three scenes (Rayforce 2013, Figure 3)."""

from __future__ import annotations

import statistics
from collections.abc import Iterator
from functools import cached_property
from typing import Any

from raystream.core.errors import RaystreamError
from raystream.jit.threads import thread_count
from raystream.rendering.ao import REACH
from raystream.rendering.integrator import RenderContext
from raystream.scene.scene import Scene
from raystream.tracer import Tracer
from raystream_lab.agreement import Row, agreement_claim, agreement_table
from raystream_lab.frame_timing import (
    Size,
    affordable_size,
    frame_seconds,
    render_context,
    report_image,
)
from raystream_lab.published import published
from raystream_lab.rayforce.scenes import REFERENCE, STRUCTURES, device_options, prepared, scenes
from raystream_lab.recording_tracer import RecordingTracer
from raystream_lab.results import Cell, Claim, Plot, Result, Series, Table, listed
from raystream_lab.runner import Runner
from raystream_lab.views import View

#: Modes, and the poster's description of each.
MODES = {
    "vis": "visible surfaces, shaded by the cosine between normal and view",
    "xray": "all surfaces along a ray as clear sheets",
    "ao": "the first surface, and 32 any-hit rays",
    "kajiya": "the first surface, any-hit shadows and two diffuse bounces",
}

#: Frames per second that count as interactive: our choice.
INTERACTIVE = 10.0

ROUNDS = 3

#: Maximum seconds per frame; larger images are reduced.
_LIMIT = 1.0
_QUICK_LIMIT = 0.2

#: May be rendered smaller than the others, which share a size.
_SLOW = "grid"

_IMAGE_SIZE = (320, 240)


#: Frames of a scene and mode, by structure.
_Frames = dict[str, dict[str, Any]]


class _Contenders:
    """Tracers of all structures for one scene, built on first use."""

    def __init__(self, runner: Runner, view: View) -> None:
        self._runner = runner
        self._view = view

    def seconds(self, structure: str, mode: str, size: Size) -> float:
        """Render and time a frame."""
        return frame_seconds(self.context, self.tracers[structure], mode, size)

    @cached_property
    def scene(self) -> Scene:
        return prepared(self._view.scene)

    @cached_property
    def tracers(self) -> dict[str, Tracer]:
        """On the CPU those that record; elsewhere plain ones, which may render on the device."""
        runner = self._runner
        kind = RecordingTracer if runner.device == "cpu" else Tracer
        return {
            name: kind(self.scene, name, progress=runner.progress, **device_options(runner, name))
            for name in STRUCTURES
        }

    @cached_property
    def _reference(self) -> RecordingTracer:
        return RecordingTracer(self.scene)

    def ray_counts(self, structure: str, mode: str, size: Size) -> tuple[int, int]:
        """Rays of a frame by the queries of the device, and of the CPU."""
        device = RecordingTracer.of_structure(
            self.tracers[structure].structure, self.scene, self._runner.device
        )
        counts = []
        for tracer in (device, self._reference):
            tracer.queries.clear()
            frame_seconds(self.context, tracer, mode, size)
            counts.append(sum(one.ray_count for one in tracer.queries))
        return counts[0], counts[1]

    @cached_property
    def context(self) -> RenderContext:
        return render_context(self.tracers[REFERENCE], frame_size(self._runner))


def frame_size(runner: Runner) -> Size:
    """The poster's 1024 x 768, or the user's size."""
    width, height = published("rayforce", "figure 3").values["size"]
    chosen = runner.device_size(width)
    return chosen, max(chosen * height // width, 1)


def render_modes(runner: Runner) -> Result:
    """Whole frames of four modes with every structure except brute force."""
    result = Result()
    found: dict[str, dict[str, _Frames]] = {mode: {} for mode in MODES}
    for view in scenes(runner, result):
        contenders = _Contenders(runner, view)
        for mode in MODES:
            frames = _measured(runner, contenders, view.name, mode)
            found[mode][view.name] = {
                name: one for name, one in frames.items() if "refused" not in one
            }
            result.notes += [
                f"{view.name}, {mode}, {name}: {one['refused']}"
                for name, one in frames.items()
                if "refused" in one
            ]
            if runner.device != "cpu":
                continue
            title = f"{view.name}: {mode}, one sample per pixel"
            name = f"rayforce {view.name} {mode}"
            result.images.append(
                report_image(runner, name, title, contenders.scene, mode, _IMAGE_SIZE)
            )
    size = frame_size(runner)
    result.tables = [_table(mode, frames, size) for mode, frames in found.items()]
    result.plots = [_plot(found, size)]
    result.claims = [_claim(found, size)]
    result.notes += list(_notes(found, size))
    if runner.device != "cpu":
        rows = _agreement_rows(found)
        title = "Rays of a frame: the device's against the CPU's"
        result.tables.append(agreement_table("rayforce-mode-rays", title, runner.device, rows))
        result.claims.append(agreement_claim(runner.device, rows))
        result.notes.append(runner.facts.note)
    return result


def _agreement_rows(found: dict[str, dict[str, _Frames]]) -> list[Row]:
    return [
        (f"{name}, {mode}, {structure}", frame["cpu_rays"], frame["rays"])
        for mode, scenes in found.items()
        for name, frames in scenes.items()
        for structure, frame in frames.items()
    ]


def _measured(runner: Runner, contenders: _Contenders, name: str, mode: str) -> _Frames:
    """Times of rounds in which structures take turns."""
    size = frame_size(runner)
    small = max(size[0] // 4, 1), max(size[1] // 4, 1)

    def measure() -> _Frames:
        frames: _Frames = {}
        refused: _Frames = {}
        for structure in contenders.tracers:
            try:
                contenders.seconds(structure, mode, small)  # compiles
                seconds = contenders.seconds(structure, mode, small)
            except RaystreamError as error:
                if runner.device == "cpu" or structure == REFERENCE:
                    raise
                refused[structure] = {"refused": str(error)}
                continue
            limit = _QUICK_LIMIT if runner.quick else _LIMIT
            pixel = seconds / (small[0] * small[1])
            frames[structure] = {
                "size": affordable_size(pixel, size, limit, small),
                "small_pixel": pixel,
                "seconds": [],
            }
        # Pixels of small frames take longer: compared frames share a size.
        common = min(frames[one]["size"] for one in frames if one != _SLOW)
        for structure, frame in frames.items():
            frame["size"] = min(frame["size"], common) if structure == _SLOW else common
        for number in range(2 if runner.quick else ROUNDS + 1):
            for structure, frame in frames.items():
                tracer = contenders.tracers[structure]
                if isinstance(tracer, RecordingTracer):
                    tracer.queries.clear()
                taken = contenders.seconds(structure, mode, frame["size"])
                if number:  # the first one may compile: kernels depend on the number of rays
                    frame["seconds"].append(taken)
                if isinstance(tracer, RecordingTracer):
                    frame["rays"] = sum(one.ray_count for one in tracer.queries)
        for structure, frame in frames.items():
            if "rays" not in frame:
                counts = contenders.ray_counts(structure, mode, frame["size"])
                frame["rays"], frame["cpu_rays"] = counts
        return frames | refused

    frames: _Frames = runner.measure(f"{name}, {mode}", measure)
    return frames


def _pixel_seconds(frame: dict[str, Any]) -> float:
    width, height = frame["size"]
    return statistics.median(frame["seconds"]) / (width * height)


def _ray_rate(frame: dict[str, Any]) -> float:
    """Million rays per second."""
    width, height = frame["size"]
    return float(frame["rays"]) / (width * height) / _pixel_seconds(frame) / 1e6


def _table(mode: str, found: dict[str, _Frames], size: Size) -> Table:
    rows: list[list[Cell]] = []
    for name, frames in found.items():
        reference = _pixel_seconds(frames[REFERENCE])
        for structure, frame in frames.items():
            pixel = _pixel_seconds(frame)
            width, height = frame["size"]
            seconds = pixel * size[0] * size[1]
            rows.append(
                [
                    name,
                    structure,
                    f"{width} x {height}",
                    frame["rays"] / (width * height),
                    1000.0 * seconds,
                    1.0 / seconds,
                    _ray_rate(frame),
                    pixel / reference,
                ]
            )
    return Table.of(
        f"rayforce-{mode}",
        f"{mode}: {MODES[mode]}; frames of {size[0]} x {size[1]} pixels",
        ["scene", "structure", "drawn", "rays per pixel", "ms", "frames/s"]
        + ["Mrays/s", f"time / {REFERENCE}'s"],
        rows,
        f"Times are of whole frames without display, medians of {ROUNDS} rounds in which "
        "structures take turns. Material tables are built once per scene. Times of reduced frames "
        "are scaled by the number of pixels.",
    )


def _plot(found: dict[str, dict[str, _Frames]], size: Size) -> Plot:
    bars = [f"{name}, {mode}" for mode, scenes in found.items() for name in scenes]
    series = []
    for structure in STRUCTURES:
        rates: list[float | None] = [
            _ray_rate(frames[structure]) if structure in frames else None
            for scenes in found.values()
            for frames in scenes.values()
        ]
        series.append(Series(structure, bars, rates))
    return Plot(
        "rayforce-modes",
        f"Rays per second in whole frames of {size[0]} x {size[1]} pixels",
        "",
        "million rays per second",
        series,
        kind="bars",
    )


def _claim(found: dict[str, dict[str, _Frames]], size: Size) -> Claim:
    """The poster's values are lost: whether rates are interactive is judged by our own bound."""
    rates = {
        f"{name}, {mode}": 1.0 / (_pixel_seconds(each[REFERENCE]) * size[0] * size[1])
        for mode, scenes in found.items()
        for name, each in scenes.items()
    }
    return Claim.judged(
        "ambient occlusion and the other modes render at interactive rates (read as: at least "
        f"{INTERACTIVE:g} frames/s)",
        published("rayforce", "figure 3").source,
        {case: rate >= INTERACTIVE for case, rate in rates.items()},
        f"the {REFERENCE} with {thread_count()} threads, frames/s: {listed(rates, '.2g')}; the "
        "poster's GeForce GTX 690 is not comparable with our hardware",
    )


def _notes(found: dict[str, dict[str, _Frames]], size: Size) -> Iterator[str]:
    yield (
        "The values of the poster's Figure 3 and its three scenes are not in our copy, so no "
        "published column is given. The scenes here are interiors with details of different sizes, "
        "or small built-in scenes instead. Scenes without lights receive one near the camera, and "
        f"all surfaces are made opaque. Rays of ao are {REACH:g} of the scene's diagonal long; the "
        "poster does not give their length."
    )
    ratios = [
        frame["small_pixel"] / _pixel_seconds(frame)
        for scenes in found.values()
        for frames in scenes.values()
        for frame in frames.values()
        if frame["size"][0] > size[0] // 4
    ]
    if ratios:
        yield (
            "Accuracy of scaling: where more than a quarter of the width was rendered, a pixel of "
            f"a quarter-width frame took {min(ratios):.2g} to {max(ratios):.2g} times as long "
            f"(median {statistics.median(ratios):.2g}). Scaled times may be too long by these "
            f"factors; {', '.join(one for one in STRUCTURES if one != _SLOW)} are rendered at the "
            "same size."
        )
