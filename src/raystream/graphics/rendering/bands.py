"""FragmentBands: samples of rows of an image, rendered in loops of the multipass machine."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.graphics.buffers import uniform, whole
from raystream.graphics.error_scope import guarded
from raystream.graphics.gather_arrays import upload_gathers
from raystream.graphics.multipass.loop_machine import LoopMachine
from raystream.graphics.multipass.plan import Plan
from raystream.graphics.multipass.ray_loop import FragmentLoop, LoopStreams
from raystream.graphics.rendering.modes import Mode, mode_of, unsupported
from raystream.graphics.rendering.path_rows import PathRows
from raystream.graphics.rendering.scene_buffers import (
    light_samples,
    punctual_rows,
    surface_arrays,
)
from raystream.graphics.rendering.uniforms import BandPlace, shading_uniform
from raystream.graphics.shader_source import shader_source, with_early_test
from raystream.jit.threads import Progress
from raystream.rendering.integrator import PathStage, RenderContext

__all__ = ["FragmentBands"]


class FragmentBands:
    """Renders samples of rows by fragment programs; see `rendering.device_bands.DeviceBands`.

    Parameters
    ----------
    context : RenderContext
        Its tables are copied to the device for the first sample.
    machine : LoopMachine
    max_pixels : int
        Most pixels of a band.
    """

    is_serial = True

    def __init__(self, context: RenderContext, machine: LoopMachine, max_pixels: int) -> None:
        self._context, self._machine, self._max_pixels = context, machine, max_pixels
        self._passes: Counter[str] = Counter()
        self._is_supported: bool | None = None
        self._scene: _ModeOnDevice | None = None

    def pixels_at_once(self, stages: Sequence[PathStage], _: int) -> int:
        """Upper bound for a band."""
        mode = mode_of(stages)
        if mode is not None and mode.branches(self._context) > 1:
            return min(self._max_pixels, PathRows.most_pixels(self._machine.rays.opened))
        return self._max_pixels

    def takes(self, stages: Sequence[PathStage]) -> bool:
        """Whether a renderer's stages are fragment programs, and these support the scene."""
        if self._is_supported is None:
            self._is_supported = unsupported(self._context) is None
        return self._is_supported and mode_of(stages) is not None

    def trace(
        self,
        stages: Sequence[PathStage],
        rows: range,
        sample: int,
        progress: Progress | None = None,
    ) -> NDArray[np.float32]:
        """Render one sample of each pixel of some rows; see `Integrator.trace`."""
        mode, width = mode_of(stages), self._context.width
        assert mode is not None
        with guarded(self._machine.rays.opened):
            if self._scene is None:
                self._scene = _ModeOnDevice(self._context, mode, self._machine)
            pixels = range(rows.start * width, rows.stop * width)
            return self._scene.render(pixels, sample, self._passes, progress)

    def start(self) -> None:
        """Count passes from here."""
        self._passes.clear()

    def figures(self) -> Mapping[str, Any]:
        """The number of passes of each kernel since `start`, if there were any."""
        return {"passes": dict(self._passes)} if self._passes else {}


class _ModeOnDevice:
    """A mode's programs, and a scene's buffers."""

    def __init__(self, context: RenderContext, mode: Mode, machine: LoopMachine) -> None:
        opened = machine.rays.opened
        self._context, self._mode, self._machine = context, mode, machine
        lights = light_samples(context) if mode.samples_lights else punctual_rows(context)
        arrays = [*surface_arrays(context), ("lights", lights)]
        self._rows = PathRows(opened) if mode.branches(context) > 1 else None
        source = self._source()
        memory = machine.rays.memory
        self._gathers = upload_gathers(opened, arrays, memory, source, first=1)
        place = BandPlace(0, 0, 0, 1)
        self._uniform = uniform(opened, shading_uniform(context, mode, place))
        self._loop = self._make_loop(machine.rays.rewrite(source))
        self._plan: Plan = machine.plan(self._loop)
        self._streams: LoopStreams | None = None
        self._place = place

    def _source(self) -> str:
        instead = {} if self._rows is None else {"rendering/one_path.wgsl": _ROWS}
        source = shader_source("rendering/eye_rays.wgsl", self._mode.shader, instead=instead)
        if self._rows is not None and self._machine.rays.opened.has_early_test:
            source = with_early_test(source, "shade")
        return source

    def _make_loop(self, source: str) -> FragmentLoop:
        context, mode = self._context, self._mode
        constants = {
            "LAST_BOUNCE": float(mode.last_bounce(context)),
            "SAMPLER": float(context.sampler.kind),
            "SPREADS": float(context.sampler.sample_count > 1),
            **mode.constants(context),
        }
        gathers = (one.kind for one in self._gathers)
        return FragmentLoop(
            source,
            constants,
            ("uniform", *gathers, *("scatter",) * bool(self._rows)),
            self._resources,
            mode.spawns(context),
            None if self._rows is None else self._grow,
        )

    def _resources(self) -> list[Any]:
        rows = [] if self._rows is None else [self._rows.binding]
        return [whole(self._uniform), *(one.resource for one in self._gathers), *rows]

    def _write(self, place: BandPlace) -> None:
        self._place = place
        content = shading_uniform(self._context, self._mode, place)
        self._machine.rays.opened.device.queue.write_buffer(self._uniform, 0, content)

    def _grow(self, encoder: Any) -> None:
        """Room for twice as many paths of each pixel."""
        assert self._rows is not None
        self._rows.grow(encoder)
        self._write(self._place._replace(room=self._rows.room))

    def render(
        self, pixels: range, sample: int, passes: Counter[str], progress: Progress | None
    ) -> NDArray[np.float32]:
        """Render one sample of some pixels."""
        count = len(pixels)
        if self._streams is None or self._streams.count != count:
            self._streams = LoopStreams(self._machine.rays.opened, count)
        room = 1
        if self._rows is not None:
            self._rows.begin(count)
            room = self._rows.room
        self._write(BandPlace(pixels.start, count, sample, room))
        return self._machine.run(self._loop, self._plan, self._streams, passes, progress)


_ROWS = "rendering/path_rows.wgsl"
