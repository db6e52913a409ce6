"""The lights that a mode adds to a dark scene, chosen for its first view."""

from __future__ import annotations

import warnings
from dataclasses import replace

from raystream.core.errors import RaystreamWarning
from raystream.rendering.integrator import RenderContext
from raystream.rendering.render import RENDERERS
from raystream.rendering.view_light import kept_choice, lit
from raystream.scene.camera import Camera
from raystream.viewer.tracers import PreparedTracer

__all__ = ["ViewLights"]

#: Side of the view for which lights are chosen; see `view_light.lit`.
_TRIAL_SIZE = 64

#: Maximum number of remembered choices.
_MAX_CHOICES = 64


class ViewLights:
    """A client's choices of lights, which it keeps: changing ones flicker."""

    def __init__(self) -> None:
        self._choices: dict[object, str] = {}

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
        chosen = self._choices.get(what)
        if chosen is None:
            if len(self._choices) >= _MAX_CHOICES:
                self._choices.clear()
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RaystreamWarning)
                seen = context.seen_by(camera, (_TRIAL_SIZE, _TRIAL_SIZE))
                chosen = self._choices[what] = kept_choice(lit(RENDERERS[mode], seen))
        return replace(context, chosen_lights=chosen)
