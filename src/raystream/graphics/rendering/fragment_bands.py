"""FragmentBands: samples of rows of an image, rendered in loops of the multipass machine."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.graphics.multipass.loop_machine import LoopMachine
from raystream.graphics.multipass.plan import Plan
from raystream.graphics.multipass.ray_loop import FragmentLoop, LoopStreams
from raystream.graphics.rendering.bands import ShaderBands
from raystream.graphics.rendering.mode_on_device import ModeOnDevice
from raystream.graphics.shader_source import shader_source, with_early_test
from raystream.jit.threads import Progress
from raystream.rendering.integrator import RenderContext

#: The fragment programs, around a mode's shading.
_ENTRIES = "multipass/loop/eye_rays.wgsl", "multipass/loop/shade.wgsl"


class FragmentBands(ShaderBands):
    """Every stage is a fragment program.

    Parameters
    ----------
    context : RenderContext
    machine : LoopMachine
    max_pixels : int
        Most pixels of a band.
    """

    _loop: FragmentLoop
    _plan: Plan
    _streams: LoopStreams | None = None

    def __init__(self, context: RenderContext, machine: LoopMachine, max_pixels: int) -> None:
        super().__init__(context, machine.rays.opened, max_pixels)
        self._machine = machine
        self._passes: Counter[str] = Counter()

    def _prepare(self, mode: ModeOnDevice) -> None:
        source = shader_source(*_ENTRIES, mode.mode.shader, instead=mode.instead)
        if mode.rows is not None and self._opened.has_early_test:
            source = with_early_test(source, "shade")
        rays = self._machine.rays
        mode.upload(rays.memory, source)
        self._mode = mode
        self._loop = FragmentLoop(
            rays.rewrite(source),
            mode.constants,
            mode.layout,
            mode.resources,
            mode.mode.spawns(self._context),
            None if mode.rows is None else mode.grow,
        )
        self._plan = self._machine.plan(self._loop)

    def _render(self, pixels: range, sample: int, progress: Progress | None) -> NDArray[np.float32]:
        if self._streams is None or self._streams.count != len(pixels):
            self._streams = LoopStreams(self._opened, len(pixels))
        self._mode.begin(pixels, sample)
        return self._machine.run(self._loop, self._plan, self._streams, self._passes, progress)

    def start(self) -> None:
        """Count passes from here."""
        self._passes.clear()

    def figures(self) -> Mapping[str, Any]:
        """The number of passes of each kernel since `start`, if there were any."""
        return {"passes": dict(self._passes)} if self._passes else {}
