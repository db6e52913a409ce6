"""The lights that a mode adds to a dark scene, chosen for its first view."""

from __future__ import annotations

import threading
from dataclasses import replace
from weakref import WeakKeyDictionary

from raystream.rendering.integrator import RenderContext
from raystream.rendering.render import RENDERERS
from raystream.rendering.view_light import kept_choice, well_lit
from raystream.scene.camera import Camera
from raystream.scene.scene import Scene
from raystream.viewer.tracers import PreparedTracer

#: Side of the view for which lights are chosen; see `view_light.well_lit`.
_TRIAL_SIZE = 64

#: Maximum number of remembered choices for a scene.
_MAX_CHOICES = 64


class ViewLights:
    """A client's choices of lights, which it keeps: changing ones flicker. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._choices: WeakKeyDictionary[Scene, dict[object, str]] = WeakKeyDictionary()

    def lit(
        self, prepared: PreparedTracer, mode: str, context: RenderContext, camera: Camera
    ) -> RenderContext:
        """Return the context with the lights that the mode's first view needs.

        Parameters
        ----------
        prepared : PreparedTracer
        mode : str
        context : RenderContext
            Of the tracer, with the mode's options.
        camera : Camera
            The view, if it is the mode's first one.
        """
        what = prepared.key, mode
        with self._lock:
            choices = self._choices.setdefault(prepared.tracer.scene, {})
            chosen = choices.get(what)
            if chosen is None:
                if len(choices) >= _MAX_CHOICES:
                    choices.clear()
                seen = context.seen_by(camera, (_TRIAL_SIZE, _TRIAL_SIZE))
                chosen = choices[what] = kept_choice(well_lit(RENDERERS[mode], seen))
        return replace(context, chosen_lights=chosen)
