"""render_frames: the frames of an animation, rendered one at a time."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from raystream.core.checks import check_choice
from raystream.core.choices import DeviceOptions
from raystream.jit.threads import Progress
from raystream.rendering.arguments import check_size
from raystream.rendering.image import Image
from raystream.rendering.lighting import MEASURED
from raystream.rendering.render import RENDERERS, render
from raystream.scene.animation import FPS, Timeline
from raystream.scene.camera import Camera
from raystream.scene.camera_track import CameraMotion
from raystream.scene.moving import have_same_faces
from raystream.scene.scene import Scene
from raystream.structures import StructureOptions
from raystream.tracer import Tracer

__all__ = ["frame_seed", "render_frames", "sample_count_of", "split_options", "timeline_of"]

#: Arguments of `render` for single images only.
_SINGLE_IMAGE_OPTIONS = ("checkpoint", "on_pass")


def sample_count_of(mode: str, samples: int | None, options: Mapping[str, Any]) -> int:
    """Samples per pixel of each frame, see `Integrator.samples`; options are those of `render`."""
    limits = {name: options[name] for name in ("noise", "time_limit", "sampler") if name in options}
    return RENDERERS[mode].samples(samples, **limits)


def frame_seed(seed: int, frame: int) -> int:
    """The seed of a frame's samples, in [0, 2**32).

    Each frame has its own: static noise would look like dirt on the lens. It depends on the two
    numbers only, so that frames can be rendered in any order and on any machine.
    """
    return int(np.random.SeedSequence([seed, frame]).generate_state(1)[0])


def render_frames(
    scene: Scene,
    mode: str = "path",
    frames: slice | int | Iterable[int] | None = None,
    size: tuple[int, int] = (1024, 768),
    samples: int | None = None,
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
        With an animation or a camera track, or static, if `camera` moves.
    mode, size, samples, structure, device, **options
        As for `render`, except ``checkpoint`` and ``on_pass``; noise and time limits apply to each
        frame.
    frames : slice, int or iterable of int, optional
        Frames to render [default: all]; see `Timeline.chosen`.
    fps : float, optional
        Frames per unit of time, usually a second [default: from the file, else 24].
    camera : Camera or CameraTrack, optional
        The view [default: the scene's camera, which may move, or one chosen for the scene as
        given, see `Scene.camera_for`].
    seed : int
        Seed of the animation; each frame has its own, see `frame_seed`.
    progress : callable, optional
        Called with (rays done, rays) of all frames.

    Returns
    -------
    iterator of (int, Image)
        Number and image of each frame, rendered on demand. Frame i is ``render(scene.at(time),
        ..., seed=frame_seed(seed, i))`` at the time ``start + i / fps``, bit for bit if both trace
        in the same local frame, as ordinary scenes do. Whether ``lights="auto"`` adds lights does
        not depend on a frame's view, else they would flicker; an added sun and light at the eye
        follow the camera.

    Raises
    ------
    ValueError
        If nothing moves, a frame is out of range, or as `render`.
    TypeError
        If `scene` is not a scene, or as `render`.

    Notes
    -----
    The structure is built once and then refitted, see `Tracer.update`; it is rebuilt when meshes
    appear or disappear.

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
    image_options, tracer_options = split_options(mode, options)
    sample_count = sample_count_of(mode, samples, image_options)
    timeline = timeline_of(scene, camera, fps)
    numbers = timeline.chosen(frames)
    if camera is None and not scene.has_own_camera:
        camera = scene.camera_for(width / height)
    image_options |= {"size": (width, height), "samples": sample_count}
    shown = (
        None
        if progress is None
        else _FrameProgress(progress, len(numbers), width * height * sample_count)
    )

    def images() -> Iterator[tuple[int, Image]]:
        tracer: Tracer | None = None
        for place, number in enumerate(numbers):
            time = timeline.time_of(number)
            tracer = _moved(tracer, scene.at(time), structure, device, tracer_options)
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
                    **image_options,
                ),
            )

    return images()


def split_options(mode: str, options: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Separate options of an image from those of a tracer."""
    check_choice("mode", mode, RENDERERS)
    for name in _SINGLE_IMAGE_OPTIONS:
        if name in options:
            raise TypeError(f"{name}: only for a single image; render each frame by itself")
    own = set(inspect.signature(render).parameters) | {*RENDERERS[mode].options, "preset"}
    image_options = {name: value for name, value in options.items() if name in own}
    if image_options.get("lights", "auto") == "auto":
        image_options["lights"] = MEASURED
    return image_options, {name: value for name, value in options.items() if name not in own}


def timeline_of(scene: Scene, camera: Camera | CameraMotion | None, fps: float | None) -> Timeline:
    """The timeline of a scene, or of a camera that moves through a static one."""
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
    """The tracer, updated to another frame's scene, or a new one if the meshes differ."""
    if (
        tracer is None
        or not have_same_faces(tracer.scene.meshes, scene.meshes)
        or not scene.has_objects_of(tracer.scene)
    ):
        return Tracer(scene, structure, device, **options)
    tracer.update(scene)
    return tracer


class _FrameProgress:
    """Reports the progress of an animation from that of its frames."""

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
