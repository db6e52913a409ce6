"""Animations on the command line: ``raystream render --frames``."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from raystream.cli import options
from raystream.cli.bars import Bars
from raystream.cli.brightness import Exposure
from raystream.cli.console import (
    BadInputError,
    InterruptedRunError,
    one_line,
    refuse,
    write_json,
    write_line,
    write_note,
)
from raystream.cli.frame_files import FrameFiles
from raystream.cli.load import Stopwatch, triangle_figures, triangle_text
from raystream.cli.render_job import RenderJob

if TYPE_CHECKING:
    from raystream.scene.animation import Timeline
    from raystream.scene.camera import Camera
    from raystream.scene.camera_track import CameraMotion
    from raystream.scene.scene import Scene


def render_animation(job: RenderJob, json: bool) -> None:
    """Render frames to files, and encode a video from them if requested."""
    asked, (width, height) = job.image, job.size
    wanted = asked.animation.parse_frames()
    files = FrameFiles.of(job.output, job.scene, isinstance(wanted, int))
    watch = Stopwatch()
    with Bars() as bars:
        with watch.measure("load"), bars.step("loading"):
            scene, camera, timeline = _open_scene(job)
        try:
            numbers = timeline.chosen(wanted)
        except ValueError as error:  # argument names equal option names
            raise BadInputError(f"--{error}") from error
        if files.video is not None:
            from raystream.rendering.video import check_video

            check_video(files.video, job.size, len(numbers))
        files.prepare(asked.resume)
        missing = numbers
        if asked.resume:
            with bars.step("looking for frames"):
                missing = tuple(n for n in numbers if not files.is_whole(n, job.size))
            if len(missing) < len(numbers):
                write_note(f"{len(numbers) - len(missing)} of {len(numbers)} frames exist already")
        for number in missing:
            options.check_replaced(files.path(number), asked.force)
        with _reporting_progress(files, numbers, missing):
            with watch.measure("frames"):
                _render(job, scene, camera, timeline.fps, missing, files, bars)
            if files.video is not None:
                with watch.measure("video"), bars.step("writing the video"):
                    _write_video(files, numbers, timeline.fps)
                files.remove(numbers)
    figures = {
        "output": str(job.output),
        "scene": job.scene,
        "mode": job.mode,
        "width": width,
        "height": height,
        "samples": job.arguments["samples"],
        "frames": len(numbers),
        "frames_before": len(numbers) - len(missing),
        "fps": timeline.fps,
        "structure": job.chosen.structure or "bvh",
        **job.chosen.figures(),
        **triangle_figures(scene),
        "seconds": watch.rounded(),
    }
    if json:
        write_json(figures)
    else:
        write_line(
            f"{one_line(str(job.output))}: {len(numbers):,} frames of "
            f"{width}x{height}, {timeline.fps:g} fps, "
            f"{triangle_text(scene)}; {watch.text()}"
        )


def _open_scene(job: RenderJob) -> tuple[Scene, Camera | CameraMotion | None, Timeline]:
    from raystream.scene.load import load

    name = job.scene
    if name.lower().endswith(".npz"):
        raise BadInputError(f"{name}: a saved structure is static; pass its scene instead")
    kinds = (ValueError,) if job.loading.triangles is not None or ":" in name else ()
    with refuse(*kinds):
        scene = load(name, triangles=job.loading.triangles)
    scene, still = job.view(job.image.lighting.apply(scene))
    camera: Camera | CameraMotion | None = None
    changes = job.image.view.changes
    if changes:
        camera = still if scene.camera_track is None else _PartlyFixedCamera(scene, still, changes)
    if scene.animation is None and scene.camera_track is None:
        raise BadInputError(f"{name}: is static; it animates neither meshes nor the camera")
    try:
        return scene, camera, scene.timeline(job.image.animation.fps)
    except ValueError as error:
        raise BadInputError(f"--{error}") from error


@dataclass(frozen=True)
class _PartlyFixedCamera:
    """An animated camera with some parameters fixed by the command line."""

    scene: Scene
    still: Camera
    changes: Mapping[str, Any]

    @property
    def times(self) -> tuple[float, float]:
        timeline = self.scene.timeline()
        return timeline.start, timeline.end

    def at(self, time: float) -> Camera:
        return dataclasses.replace(self.scene.camera_at(time), **self.changes)


def _render(
    job: RenderJob,
    scene: Scene,
    camera: Camera | CameraMotion | None,
    fps: float,
    missing: tuple[int, ...],
    files: FrameFiles,
    bars: Bars,
) -> None:
    if not missing:
        return
    with (
        job.workers.client() as client,
        bars.step(f"rendering {len(missing)} frames") as progress,
        job.chosen.blamed(),
    ):
        if client is None:
            from raystream.rendering.frames import render_frames
        else:
            from raystream.cluster.animations import render_frames as render_there

            render_frames = partial(render_there, client=client)
        images = render_frames(
            scene,
            job.mode,
            missing,
            job.size,
            fps=fps,
            camera=camera,
            progress=progress,
            **job.arguments,
            **job.chosen.keywords(),
        )
        job.layers.report_denoiser()
        exposure = Exposure(job.image.exposure, job.image.lighting, scene, job.mode, is_fixed=True)
        for number, image in images:
            if job.layers.is_denoised:
                image = job.layers.denoise(image)
            path = files.path(number)
            job.image.save(image, path, exposure)
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
