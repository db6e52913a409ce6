"""Films on the command line: ``raystream render --frames``."""

from __future__ import annotations

import contextlib
import dataclasses
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from raystream.cli import options
from raystream.cli.bars import Bars
from raystream.cli.clusters import joined
from raystream.cli.environment import tell_added_light, with_environment
from raystream.cli.keywords import blame_options, machine_figures
from raystream.cli.layers import Kept
from raystream.cli.messages import (
    BadInputError,
    BrokenOffError,
    one_line,
    refuse,
    write_json,
    write_line,
    write_note,
)
from raystream.cli.opening import Stopwatch

if TYPE_CHECKING:
    from raystream.scene.animation import Timeline
    from raystream.scene.camera import Camera
    from raystream.scene.camera_track import CameraMotion
    from raystream.scene.scene import Scene

__all__ = ["FilmAsked", "Fps", "Frames", "is_film", "refuse_beside_frames", "render_film"]

#: What a video's name may end in; a test compares them with the library's.
VIDEOS = (".mp4", ".webm", ".mkv", ".mov", ".gif", ".webp", ".apng")
PICTURES = (".png", ".exr")

_PATTERN = re.compile(r"%0?(\d{0,2})d")

Frames = Annotated[
    str | None,
    typer.Option(
        metavar="RANGE",
        show_default=False,
        help="Frames of a scene that moves, as Python counts: 0:100, 0:100:5, 7, -1, or : for all. "
        "--output is then a pattern, such as name%04d.png, a folder, or a video: "
        f"{' '.join(VIDEOS)}; the first four need ffmpeg.",
    ),
]
Fps = Annotated[
    float | None,
    typer.Option(
        metavar="RATE",
        show_default=False,
        callback=options.positive_if_given,
        help="Frames in a second; without it, what the scene's file says, or 24.",
    ),
]


@dataclass(frozen=True)
class FilmAsked:
    """What is to be filmed.

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
        Parts of the view, and ``which`` of the scene's cameras.
    exposure : float
    tone : str
    arguments : dict
        Of the mode.
    structure, device : str
    chosen : dict
        Options of the tracer.
    triangles : int or None
    environment : Path or None
    environment_rotation : float
    denoised : Kept or None
        Which layers remain of pictures that are to be smoothed.
    cluster : str or None
    threads : int or None
        Of each worker that is started for it.
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
    denoised: Kept | None
    cluster: str | None = None
    threads: int | None = None


def is_film(output: Path, frames: str | None) -> bool:
    """Whether more than a picture is asked for: by ``--frames``, a pattern or a video."""
    return (
        frames is not None
        or output.suffix.lower() in VIDEOS
        or _PATTERN.search(output.name) is not None
    )


def refuse_beside_frames(given: Mapping[str, Any]) -> None:
    """Refuse options that have no place beside frames; by name, None or 0 for not given."""
    for name, value in given.items():
        if value:
            raise BadInputError(f"--{name}: not with --frames")


def parse_frames(text: str | None) -> slice | int | None:
    """Read ``0:100``, ``0:100:5`` or ``7``; `BadInputError` if it is none."""
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


@dataclass
class _Files:
    """Where the frames of a film go.

    Attributes
    ----------
    folder : Path
    pattern : str
        Of the frames' names in it.
    video : Path or None
        Made of them; the folder is then removed.
    """

    folder: Path
    pattern: str
    video: Path | None = None
    made: list[Path] = field(default_factory=list)

    @classmethod
    def of(cls, asked: FilmAsked, one: bool) -> _Files:
        """Read ``--output``; `BadInputError` if it names no such place."""
        output = asked.output
        if output.suffix.lower() in VIDEOS:
            options.check_output(output, VIDEOS, [asked.scene])
            return cls(output.with_name(f"{output.name}.frames"), "%06d.png", output)
        found = _PATTERN.findall(output.name)
        if output.is_dir() or (not output.suffix and not found):
            if not output.parent.is_dir():
                raise BadInputError(f"{output}: there is no folder {output.parent}")
            return cls(output, "%04d.png")
        options.check_suffix(output, PICTURES, "writing")
        if len(found) > 1 or (not found and not one):
            raise BadInputError(
                f"{output}: expected one place for the number, as in name%04d.png, a folder, "
                f"or a video ({' '.join(VIDEOS)})"
            )
        options.check_output(output, PICTURES, [asked.scene])
        return cls(output.parent, output.name)

    def path(self, number: int) -> Path:
        """The file of a frame."""
        name = _PATTERN.sub(lambda found: found[0] % number, self.pattern)
        return self.folder / name

    def prepare(self, resume: bool) -> None:
        """Make the folder; refuse one that may hold the work of hours."""
        if self.video is not None and self.folder.exists() and not resume:
            raise BadInputError(
                f"{self.folder}: keeps the frames of a video that was broken off; go on from "
                "them with --resume, or remove it"
            )
        with refuse(OSError, where=str(self.folder)):
            self.folder.mkdir(exist_ok=True)

    def is_whole(self, number: int, size: tuple[int, int]) -> bool:
        """Whether a frame is there, can be read, and has the size."""
        from raystream.rendering.image import Image

        path = self.path(number)
        if not path.is_file():
            return False
        try:
            found = Image.load(path).size
        except ValueError:  # damaged
            return False
        if found != size:
            raise BadInputError(
                f"{path}: is {found[0]}x{found[1]}, not {size[0]}x{size[1]}: a frame of another "
                "film; remove it, or choose another --output"
            )
        return True

    def remove(self, numbers: tuple[int, ...]) -> None:
        """Remove the frames that a video was made of."""
        for number in numbers:
            self.path(number).unlink(missing_ok=True)
        with contextlib.suppress(OSError):  # something else is in there
            self.folder.rmdir()


def render_film(asked: FilmAsked, json: bool) -> None:
    """Render frames to files, and make a video of them if one is asked for."""
    wanted = parse_frames(asked.frames)
    files = _Files.of(asked, isinstance(wanted, int))
    watch = Stopwatch()
    with Bars() as bars:
        with watch.measure("load"), bars.step("loading"):
            scene, camera, timeline = _opened(asked)
        tell_added_light(scene, asked.mode, asked.arguments["lights"])
        try:
            numbers = timeline.chosen(wanted)
        except ValueError as error:  # its name is that of the option
            raise BadInputError(f"--{error}") from error
        if files.video is not None:
            from raystream.rendering.video import check_video

            check_video(files.video, asked.size, len(numbers))
        files.prepare(asked.resume)
        missing = numbers
        if asked.resume:
            with bars.step("looking for frames"):
                missing = tuple(n for n in numbers if not files.is_whole(n, asked.size))
            if len(missing) < len(numbers):
                write_note(f"{len(numbers) - len(missing)} of {len(numbers)} frames are there")
        with _counting(files, numbers, missing):
            with watch.measure("frames"):
                _render(asked, scene, camera, timeline, missing, files, bars)
            if files.video is not None:
                with watch.measure("video"), bars.step("writing the video"):
                    _write_video(files, numbers, timeline.fps)
                files.remove(numbers)
    figures = {
        "output": str(asked.output),
        "scene": asked.scene,
        "mode": asked.mode,
        "width": asked.size[0],
        "height": asked.size[1],
        "samples": asked.arguments["samples"],
        "frames": len(numbers),
        "frames_before": len(numbers) - len(missing),
        "fps": timeline.fps,
        "structure": asked.structure,
        **machine_figures(asked.chosen, asked.device),
        "triangles": scene.triangle_count,
        "seconds": watch.rounded(),
    }
    if json:
        write_json(figures)
    else:
        write_line(
            f"{one_line(str(asked.output))}: {len(numbers):,} frames of "
            f"{asked.size[0]}x{asked.size[1]}, {timeline.fps:g} a second, "
            f"{scene.triangle_count:,} triangles; {watch.text()}"
        )


def _opened(asked: FilmAsked) -> tuple[Scene, Camera | CameraMotion | None, Timeline]:
    from raystream.scene.load import load

    if asked.scene.lower().endswith(".npz"):
        raise BadInputError(f"{asked.scene}: a saved structure does not move; give its scene")
    kinds = (ValueError,) if asked.triangles is not None or ":" in asked.scene else ()
    with refuse(*kinds):
        scene = load(asked.scene, triangles=asked.triangles)
    if asked.environment is not None:
        scene = with_environment(scene, asked.environment, asked.environment_rotation)
    parts = dict(asked.camera)
    which = parts.pop("which", None)
    with refuse(ValueError, where="--camera"):
        if which is not None:
            scene = scene.replace(camera=which)
        camera: Camera | CameraMotion | None = None
        if parts:
            still = dataclasses.replace(scene.camera_for(asked.size[0] / asked.size[1]), **parts)
            camera = still if scene.camera_track is None else _Replaced(scene, still, parts)
    if scene.animation is None and scene.camera_track is None:
        raise BadInputError(f"{asked.scene}: nothing moves in it, neither meshes nor the camera")
    try:
        return scene, camera, scene.timeline(asked.fps)
    except ValueError as error:
        raise BadInputError(f"--{error}") from error


@dataclass(frozen=True)
class _Replaced:
    """A camera that moves, but for the parts that the command line gives."""

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
    asked: FilmAsked,
    scene: Scene,
    camera: Camera | CameraMotion | None,
    timeline: Timeline,
    missing: tuple[int, ...],
    files: _Files,
    bars: Bars,
) -> None:
    if not missing:
        return
    title = f"rendering {len(missing)} frames"
    with (
        joined(asked.cluster, asked.threads) as client,
        bars.step(title) as progress,
        blame_options(asked.chosen),
    ):
        if client is None:
            from raystream.rendering.frames import render_frames
        else:
            from functools import partial

            from raystream.cluster.animations import render_frames as render_there

            render_frames = partial(render_there, client=client)
        pictures = render_frames(
            scene,
            asked.mode,
            missing,
            asked.size,
            structure=asked.structure,
            device=asked.device,
            fps=timeline.fps,
            camera=camera,
            progress=progress,
            **asked.arguments,
            **asked.chosen,
        )
        for number, image in pictures:
            path = files.path(number)
            if asked.denoised is not None:
                image = asked.denoised.denoised(image)
            with refuse(OSError, where=str(path)):
                image.save(path, exposure=asked.exposure, tone=asked.tone)
            files.made.append(path)


@contextlib.contextmanager
def _counting(files: _Files, numbers: tuple[int, ...], missing: tuple[int, ...]) -> Iterator[None]:
    """After Ctrl-C, say how many frames there are."""
    try:
        yield
    except KeyboardInterrupt:
        there = len(numbers) - len(missing) + len(files.made)
        raise BrokenOffError(
            f"{there} of {len(numbers)} frames are in {files.folder}: the same command with "
            "--resume goes on from them"
        ) from None


def _write_video(files: _Files, numbers: tuple[int, ...], fps: float) -> None:
    from raystream.rendering.image import Image
    from raystream.rendering.video import write_video

    assert files.video is not None
    pictures = (Image.load(files.path(number)) for number in numbers)
    with refuse(OSError, where=str(files.video)):
        write_video(files.video, pictures, fps)
