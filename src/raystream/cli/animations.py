"""Animations on the command line: ``raystream render --frames``."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from raystream.cli import options
from raystream.cli.bars import Bars
from raystream.cli.clusters import cluster_client
from raystream.cli.console import (
    BadInputError,
    InterruptedRunError,
    one_line,
    refuse,
    write_json,
    write_line,
    write_note,
)
from raystream.cli.environment import report_added_light, with_environment
from raystream.cli.frame_files import FRAME_NUMBER, VIDEOS, FrameFiles
from raystream.cli.layers import LayerSelection
from raystream.cli.load import Stopwatch
from raystream.cli.tracer_options import blame_options, machine_figures

if TYPE_CHECKING:
    from raystream.scene.animation import Timeline
    from raystream.scene.camera import Camera
    from raystream.scene.camera_track import CameraMotion
    from raystream.scene.scene import Scene

__all__ = [
    "AnimationOptions",
    "Fps",
    "Frames",
    "is_animation",
    "refuse_beside_frames",
    "render_animation",
]

Frames = Annotated[
    str | None,
    typer.Option(
        metavar="RANGE",
        show_default=False,
        help="Frames of an animated scene, as a Python index or slice: 0:100, 0:100:5, 7, -1, or : "
        "for all. --output is then a pattern such as name%04d.png, a folder, or a video: "
        f"{' '.join(VIDEOS)}; the first four need ffmpeg.",
    ),
]
Fps = Annotated[
    float | None,
    typer.Option(
        metavar="RATE",
        show_default=False,
        callback=options.positive_if_given,
        help="Frame rate [default: from the scene file, else 24]",
    ),
]


@dataclass(frozen=True)
class AnimationOptions:
    """Arguments of an animation render.

    Attributes
    ----------
    scene : str
    output : Path
    frames : str or None
    fps : float or None
    resume : bool
    mode : str
    size : (int, int)
    camera : dict
        Camera parameters, and ``which`` of the scene's cameras.
    exposure : float
    tone : str
    arguments : dict
        Arguments of the mode.
    structure, device : str
    chosen : dict
        Tracer options.
    triangles : int or None
    environment : Path or None
    environment_rotation : float
    denoised : LayerSelection or None
        The layers to keep in denoised images; None renders without denoising.
    cluster : str or None
    threads : int or None
        Threads of each worker started for it.
    """

    scene: str
    output: Path
    frames: str | None
    fps: float | None
    resume: bool
    mode: str
    size: tuple[int, int]
    camera: Mapping[str, Any]
    exposure: float
    tone: str
    arguments: Mapping[str, Any]
    structure: str
    device: str
    chosen: Mapping[str, Any]
    triangles: int | None
    environment: Path | None
    environment_rotation: float
    denoised: LayerSelection | None
    cluster: str | None = None
    threads: int | None = None


def is_animation(output: Path, frames: str | None) -> bool:
    """Whether an animation is requested: by ``--frames``, a pattern or a video."""
    return (
        frames is not None
        or output.suffix.lower() in VIDEOS
        or FRAME_NUMBER.search(output.name) is not None
    )


def refuse_beside_frames(given: Mapping[str, Any]) -> None:
    """Reject options that cannot be combined with frames; None or 0 means omitted."""
    for name, value in given.items():
        if value:
            raise BadInputError(f"--{name}: cannot be combined with --frames")


def parse_frames(text: str | None) -> slice | int | None:
    """Parse ``0:100``, ``0:100:5`` or ``7``; `BadInputError` otherwise."""
    if text is None:
        return None
    parts = text.strip().split(":")
    try:
        numbers = [int(part) if part.strip() else None for part in parts]
    except ValueError:
        numbers = []
    if len(numbers) == 1 and numbers[0] is not None:
        return numbers[0]
    if len(numbers) not in (2, 3):
        raise BadInputError(f"--frames: expected 0:100, 0:100:5 or 7, got {text!r}")
    return slice(*numbers)


def render_animation(animation: AnimationOptions, json: bool) -> None:
    """Render frames to files, and encode a video from them if requested."""
    wanted = parse_frames(animation.frames)
    files = FrameFiles.of(animation.output, animation.scene, isinstance(wanted, int))
    watch = Stopwatch()
    with Bars() as bars:
        with watch.measure("load"), bars.step("loading"):
            scene, camera, timeline = _open_scene(animation)
        report_added_light(scene, animation.mode, animation.arguments["lights"])
        try:
            numbers = timeline.chosen(wanted)
        except ValueError as error:  # argument names equal option names
            raise BadInputError(f"--{error}") from error
        if files.video is not None:
            from raystream.rendering.video import check_video

            check_video(files.video, animation.size, len(numbers))
        files.prepare(animation.resume)
        missing = numbers
        if animation.resume:
            with bars.step("looking for frames"):
                missing = tuple(n for n in numbers if not files.is_whole(n, animation.size))
            if len(missing) < len(numbers):
                write_note(f"{len(numbers) - len(missing)} of {len(numbers)} frames exist already")
        with _reporting_progress(files, numbers, missing):
            with watch.measure("frames"):
                _render(animation, scene, camera, timeline, missing, files, bars)
            if files.video is not None:
                with watch.measure("video"), bars.step("writing the video"):
                    _write_video(files, numbers, timeline.fps)
                files.remove(numbers)
    figures = {
        "output": str(animation.output),
        "scene": animation.scene,
        "mode": animation.mode,
        "width": animation.size[0],
        "height": animation.size[1],
        "samples": animation.arguments["samples"],
        "frames": len(numbers),
        "frames_before": len(numbers) - len(missing),
        "fps": timeline.fps,
        "structure": animation.structure,
        **machine_figures(animation.chosen, animation.device),
        "triangles": scene.triangle_count,
        "seconds": watch.rounded(),
    }
    if json:
        write_json(figures)
    else:
        write_line(
            f"{one_line(str(animation.output))}: {len(numbers):,} frames of "
            f"{animation.size[0]}x{animation.size[1]}, {timeline.fps:g} fps, "
            f"{scene.triangle_count:,} triangles; {watch.text()}"
        )


def _open_scene(
    animation: AnimationOptions,
) -> tuple[Scene, Camera | CameraMotion | None, Timeline]:
    from raystream.scene.load import load

    if animation.scene.lower().endswith(".npz"):
        raise BadInputError(
            f"{animation.scene}: a saved structure is static; pass its scene instead"
        )
    kinds = (ValueError,) if animation.triangles is not None or ":" in animation.scene else ()
    with refuse(*kinds):
        scene = load(animation.scene, triangles=animation.triangles)
    if animation.environment is not None:
        scene = with_environment(scene, animation.environment, animation.environment_rotation)
    parts = dict(animation.camera)
    which = parts.pop("which", None)
    with refuse(ValueError, where="--camera"):
        if which is not None:
            scene = scene.replace(camera=which)
        camera: Camera | CameraMotion | None = None
        if parts:
            still = dataclasses.replace(
                scene.camera_for(animation.size[0] / animation.size[1]), **parts
            )
            camera = (
                still if scene.camera_track is None else _PartlyFixedCamera(scene, still, parts)
            )
    if scene.animation is None and scene.camera_track is None:
        raise BadInputError(
            f"{animation.scene}: is static; it animates neither meshes nor the camera"
        )
    try:
        return scene, camera, scene.timeline(animation.fps)
    except ValueError as error:
        raise BadInputError(f"--{error}") from error


@dataclass(frozen=True)
class _PartlyFixedCamera:
    """An animated camera with some parameters fixed by the command line."""

    scene: Scene
    still: Camera
    parts: Mapping[str, Any]

    @property
    def times(self) -> tuple[float, float]:
        timeline = self.scene.timeline()
        return timeline.start, timeline.end

    def at(self, time: float) -> Camera:
        return dataclasses.replace(self.scene.camera_at(time), **self.parts)


def _render(
    animation: AnimationOptions,
    scene: Scene,
    camera: Camera | CameraMotion | None,
    timeline: Timeline,
    missing: tuple[int, ...],
    files: FrameFiles,
    bars: Bars,
) -> None:
    if not missing:
        return
    title = f"rendering {len(missing)} frames"
    with (
        cluster_client(animation.cluster, animation.threads) as client,
        bars.step(title) as progress,
        blame_options(animation.chosen),
    ):
        if client is None:
            from raystream.rendering.frames import render_frames
        else:
            from functools import partial

            from raystream.cluster.animations import render_frames as render_there

            render_frames = partial(render_there, client=client)
        images = render_frames(
            scene,
            animation.mode,
            missing,
            animation.size,
            structure=animation.structure,
            device=animation.device,
            fps=timeline.fps,
            camera=camera,
            progress=progress,
            **animation.arguments,
            **animation.chosen,
        )
        for number, image in images:
            path = files.path(number)
            if animation.denoised is not None:
                image = animation.denoised.denoised(image)
            with refuse(OSError, where=str(path)):
                image.save(path, exposure=animation.exposure, tone=animation.tone)
            files.made.append(path)


@contextlib.contextmanager
def _reporting_progress(
    files: FrameFiles, numbers: tuple[int, ...], missing: tuple[int, ...]
) -> Iterator[None]:
    """After Ctrl-C, report how many frames are finished."""
    try:
        yield
    except KeyboardInterrupt:
        there = len(numbers) - len(missing) + len(files.made)
        raise InterruptedRunError(
            f"{there} of {len(numbers)} frames are in {files.folder}; rerun with --resume to "
            "continue"
        ) from None


def _write_video(files: FrameFiles, numbers: tuple[int, ...], fps: float) -> None:
    from raystream.rendering.image import Image
    from raystream.rendering.video import write_video

    assert files.video is not None
    images = (Image.load(files.path(number)) for number in numbers)
    with refuse(OSError, where=str(files.video)):
        write_video(files.video, images, fps)
