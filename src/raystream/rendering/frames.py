"""Frames: the pictures of a scene that moves, one after another."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from raystream.core.choices import DeviceOptions
from raystream.jit.threads import Progress
from raystream.rendering.arguments import check_samples, check_size
from raystream.rendering.image import Image
from raystream.rendering.render import RENDERERS, render
from raystream.scene.animation import FPS, Timeline
from raystream.scene.camera import Camera
from raystream.scene.camera_track import CameraMotion
from raystream.scene.moving import have_same_faces
from raystream.scene.scene import Scene
from raystream.structures import StructureOptions
from raystream.tracer import Tracer

__all__ = ["frame_seed", "render_frames", "split_options", "timeline_of"]

#: Arguments of `render` that make no sense for many pictures.
_OF_ONE_PICTURE = ("checkpoint", "on_pass")


def frame_seed(seed: int, frame: int) -> int:
    """The seed of a frame's samples, in [0, 2**32).

    Noise that stays where it is looks like dirt on the lens, so each frame has its own. It
    depends on nothing but the two numbers: frames can be rendered in any order, by anyone.
    """
    return int(np.random.SeedSequence([seed, frame]).generate_state(1)[0])


def render_frames(
    scene: Scene,
    mode: str = "raycast",
    frames: slice | int | Iterable[int] | None = None,
    size: tuple[int, int] = (1024, 768),
    samples: int = 1,
    structure: str | StructureOptions = "bvh",
    device: str | DeviceOptions = "cpu",
    *,
    fps: float | None = None,
    camera: Camera | CameraMotion | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    **options: Any,
) -> Iterator[tuple[int, Image]]:
    """Render the frames of a scene that moves, one at a time.

    Parameters
    ----------
    scene : Scene
        With an animation or a camera track, or still, if `camera` moves.
    mode, size, samples, structure, device, **options
        As for `render`, without ``checkpoint`` and ``on_pass``; limits of noise and time are
        those of each frame.
    frames : slice, int or iterable of int, optional
        Which of the frames; all without it. See `Timeline.chosen`.
    fps : float, optional
        Frames in a unit of time, as a rule a second; without it, what the file says, else 24.
    camera : Camera or CameraTrack, optional
        The view; without it, the scene's, which may move, or one that frames the scene as it
        was given.
    seed : int
        Of the whole; each frame has its own, see `frame_seed`.
    progress : callable, optional
        Called with (rays done, rays) of all frames.

    Returns
    -------
    iterator of (int, Image)
        Number and picture of each frame, rendered when it is asked for. Frame i is what
        ``render(scene.at(time), ..., seed=frame_seed(seed, i))`` makes of the time ``start +
        i / fps``, to the bit where both trace in the same local frame, as ordinary scenes do.

    Raises
    ------
    ValueError
        If nothing moves, a frame is not there, or as `render`.
    TypeError
        If `scene` is no scene, or as `render`.

    Notes
    -----
    The structure is built once and then moved, see `Tracer.update`; a new one is built where
    meshes come or go.

    Examples
    --------
    >>> import raystream as rs
    >>> track = rs.CameraTrack(rs.load("cornell").camera, [[0, 278, 273, -800], [2, 278, 273, 0]])
    >>> for frame, image in rs.render_frames(
    ...     rs.load("cornell"), frames=slice(0, 48, 24), size=(8, 6), camera=track
    ... ):
    ...     print(frame, image)
    0 Image(8x6)
    24 Image(8x6)
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"scene: expected a Scene, got {type(scene).__name__}; see rs.load")
    width, height = check_size(size)
    of_picture, of_tracer = split_options(mode, options)
    timeline = timeline_of(scene, camera, fps)
    numbers = timeline.chosen(frames)
    if camera is None and not scene.has_own_camera:
        camera = scene.camera_for(width / height)
    of_picture |= {"size": (width, height), "samples": check_samples(samples)}
    shown = None if progress is None else _Shown(progress, len(numbers), width * height * samples)

    def pictures() -> Iterator[tuple[int, Image]]:
        tracer: Tracer | None = None
        for place, number in enumerate(numbers):
            time = timeline.time_of(number)
            tracer = _moved(tracer, scene.at(time), structure, device, of_tracer)
            view = camera if camera is None or isinstance(camera, Camera) else camera.at(time)
            report = None if shown is None else shown.of(place)
            yield (
                number,
                render(
                    tracer,
                    mode,
                    camera=view,
                    seed=frame_seed(seed, number),
                    progress=report,
                    **of_picture,
                ),
            )

    return pictures()


def split_options(mode: str, options: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Tell options of a picture from those of a tracer."""
    if mode not in RENDERERS:
        known = ", ".join(repr(known) for known in RENDERERS)
        raise ValueError(f"mode: expected one of {known}, got {mode!r}")
    for name in _OF_ONE_PICTURE:
        if name in options:
            raise TypeError(f"{name}: only for a single picture; render each frame for itself")
    own = set(inspect.signature(render).parameters) | set(RENDERERS[mode].options)
    of_picture = {name: value for name, value in options.items() if name in own}
    return of_picture, {name: value for name, value in options.items() if name not in own}


def timeline_of(scene: Scene, camera: Camera | CameraMotion | None, fps: float | None) -> Timeline:
    """The scene's frames; those of a camera that moves through a still scene."""
    if camera is None or isinstance(camera, Camera) or scene.animation is not None:
        return scene.timeline(fps)
    return Timeline(*camera.times, FPS if fps is None else fps)


def _moved(
    tracer: Tracer | None,
    scene: Scene,
    structure: str | StructureOptions,
    device: str | DeviceOptions,
    options: Mapping[str, Any],
) -> Tracer:
    """The tracer with the scene of another frame; a new one where it has other triangles."""
    if tracer is None or not have_same_faces(tracer.scene.meshes, scene.meshes):
        return Tracer(scene, structure, device, **options)
    tracer.update(scene)
    return tracer


class _Shown:
    """Shows the progress of all frames by that of each."""

    def __init__(self, progress: Progress, frame_count: int, rays: int) -> None:
        self._progress = progress
        self._frame_count = frame_count
        self._rays = rays

    def of(self, place: int) -> Progress:
        """The callback of one frame."""

        def report(done: int, total: int) -> None:
            before = place * self._rays
            here = self._rays * done // max(total, 1)
            self._progress(before + here, self._frame_count * self._rays)

        return report
