"""The lights that a mode adds to a dark scene, chosen for its first view on any device."""

from __future__ import annotations

import threading
from dataclasses import replace
from weakref import WeakKeyDictionary

from raystream.rendering.integrator import RenderContext
from raystream.rendering.render import RENDERERS
from raystream.rendering.view_light import kept_choice, usual_context, well_lit
from raystream.scene.camera import Camera
from raystream.scene.scene import Scene
from raystream.viewer.tracers import PreparedTracer


class ViewLights:
    """A client's choices of lights, which it keeps: changing ones flicker. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._choices: WeakKeyDictionary[Scene, dict[str, str]] = WeakKeyDictionary()

    def lit(
        self, prepared: PreparedTracer, mode: str, context: RenderContext, camera: Camera
    ) -> RenderContext:
        """Return the context with the lights that the mode's first view needs.

        They are those of `render` by its defaults, and do not change with the device.

        Parameters
        ----------
        prepared : PreparedTracer
        mode : str
        context : RenderContext
            Of the tracer, with the mode's options.
        camera : Camera
            The view, if it is the mode's first one.
        """
        with self._lock:
            choices = self._choices.setdefault(prepared.tracer.scene, {})
            chosen = choices.get(mode)
            if chosen is None:
                renderer = RENDERERS[mode]
                seen = usual_context(renderer, context, camera)
                chosen = choices[mode] = kept_choice(well_lit(renderer, seen))
        return replace(context, chosen_lights=chosen)
