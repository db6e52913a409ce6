"""ModeOnDevice: a mode's shading and a scene's surfaces and lights, as shaders read them."""

from __future__ import annotations

from typing import Any

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.buffers import uniform, whole
from raystream.graphics.gather_arrays import upload_gathers
from raystream.graphics.pipelines import Layout
from raystream.graphics.rendering.modes import Mode
from raystream.graphics.rendering.path_rows import PathRows
from raystream.graphics.rendering.scene_buffers import (
    light_samples,
    punctual_rows,
    surface_arrays,
)
from raystream.graphics.rendering.uniforms import BandPlace, shading_uniform
from raystream.rendering.integrator import RenderContext

_ROWS = "rendering/path_rows.wgsl"

#: Of surfaces, and the lights.
_ARRAY_COUNT = 7


class ModeOnDevice:
    """A mode's constants, and the resources of bind group 1.

    Parameters
    ----------
    context : RenderContext
    mode : Mode
    opened : OpenDevice

    Attributes
    ----------
    context, mode
    rows : PathRows or None
        For modes whose paths spawn several.
    instead : dict of str to str
        Shader files to replace; see `shader_source`.
    constants : dict of str to float
        Values of ``override`` declarations.
    """

    def __init__(self, context: RenderContext, mode: Mode, opened: OpenDevice) -> None:
        self.context, self.mode, self._opened = context, mode, opened
        self.rows = PathRows(opened) if mode.branches(context) > 1 else None
        self.instead = {} if self.rows is None else {"rendering/one_path.wgsl": _ROWS}
        self.constants = {
            "LAST_BOUNCE": float(mode.last_bounce(context)),
            "SAMPLER": float(context.sampler.kind),
            "SPREADS": float(context.sampler.sample_count > 1),
            **mode.constants(context),
        }
        self._place = BandPlace(0, 0, 0, 1)
        self._uniform = uniform(opened, shading_uniform(context, mode, self._place))

    def upload(self, memory: str, source: str) -> None:
        """Copy the scene's arrays, which a source reads; see `upload_gathers`."""
        context = self.context
        lights = light_samples(context) if self.mode.samples_lights else punctual_rows(context)
        arrays = [*surface_arrays(context), ("lights", lights)]
        self._gathers = upload_gathers(self._opened, arrays, memory, source, first=1)

    @property
    def array_count(self) -> int:
        """The number of arrays that `upload` copies."""
        return _ARRAY_COUNT

    @property
    def layout(self) -> Layout:
        """Of the bind group."""
        kinds = (one.kind for one in self._gathers)
        return ("uniform", *kinds, *("scatter",) * (self.rows is not None))

    def resources(self) -> list[Any]:
        """Resources of the bind group; new ones after `grow`."""
        rows = [] if self.rows is None else [self.rows.binding]
        return [whole(self._uniform), *(one.resource for one in self._gathers), *rows]

    def begin(self, pixels: range, sample: int) -> None:
        """Begin a sample of some pixels."""
        room = 1
        if self.rows is not None:
            self.rows.begin(len(pixels))
            room = self.rows.room
        self._write(BandPlace(pixels.start, len(pixels), sample, room))

    def grow(self, encoder: Any) -> None:
        """Room for twice as many paths of each pixel."""
        assert self.rows is not None
        self.rows.grow(encoder)
        self._write(self._place._replace(room=self.rows.room))

    def _write(self, place: BandPlace) -> None:
        self._place = place
        content = shading_uniform(self.context, self.mode, place)
        self._opened.device.queue.write_buffer(self._uniform, 0, content)
