"""Output files of an animation: numbered frames, and the video encoded from them."""

from __future__ import annotations

import contextlib
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from raystream.cli import options
from raystream.cli.console import BadInputError, refuse

#: Video extensions; a test compares them with the library's.
VIDEOS = (".mp4", ".webm", ".mkv", ".mov", ".gif", ".webp", ".apng")
#: Image extensions.
IMAGES = (".png", ".exr", ".hdr")

#: The placeholder of the frame number in a file name.
FRAME_NUMBER = re.compile(r"%0?(\d{0,2})d")


@dataclass(frozen=True)
class AnimationOptions:
    """Options of an animation's frames."""

    frames: Annotated[
        str | None,
        options.value(
            "RANGE",
            "Frames of an animated scene, as a Python index or slice: 0:100, 0:100:5, 7, -1, "
            "or : for all. --output is then a pattern such as name%04d.png, a folder, or a video: "
            f"{' '.join(VIDEOS)}; the first four need raystream[video].",
        ),
    ] = None
    fps: Annotated[
        float | None,
        options.positive_number("RATE", "Frame rate [default: from the scene file, else 24]"),
    ] = None

    def is_animation(self, output: Path | None) -> bool:
        """Whether an animation is requested: by ``--frames``, a pattern or a video."""
        if output is None:
            return self.frames is not None
        return (
            self.frames is not None
            or output.suffix.lower() in VIDEOS
            or FRAME_NUMBER.search(output.name) is not None
        )

    def parse_frames(self) -> slice | int | None:
        """Parse ``0:100``, ``0:100:5`` or ``7``; `BadInputError` otherwise."""
        if self.frames is None:
            return None
        parts = self.frames.strip().split(":")
        try:
            numbers = [int(part) if part.strip() else None for part in parts]
        except ValueError:
            numbers = []
        if len(numbers) == 1 and numbers[0] is not None:
            return numbers[0]
        if len(numbers) not in (2, 3):
            raise BadInputError(f"--frames: expected 0:100, 0:100:5 or 7, got {self.frames!r}")
        return slice(*numbers)


@dataclass
class FrameFiles:
    """The output files of an animation.

    Attributes
    ----------
    folder : Path
    pattern : str
        Pattern of the frames' file names.
    video : Path or None
        The video to encode; the folder is removed afterwards.
    """

    folder: Path
    pattern: str
    video: Path | None = None
    made: list[Path] = field(default_factory=list)

    @classmethod
    def of(cls, output: Path, scene: str, one: bool) -> FrameFiles:
        """Interpret ``--output``; `BadInputError` if it names neither frames nor a video."""
        if output.suffix.lower() in VIDEOS:
            options.check_output(output, VIDEOS, [scene])
            return cls(output.with_name(f"{output.name}.frames"), "%06d.png", output)
        found = FRAME_NUMBER.findall(output.name)
        if output.is_dir() or (not output.suffix and not found):
            if not output.parent.is_dir():
                raise BadInputError(f"{output}: folder {output.parent} does not exist")
            return cls(output, "%04d.png")
        options.check_suffix(output, IMAGES, "writing")
        if len(found) > 1 or (not found and not one):
            raise BadInputError(
                f"{output}: expected one frame number placeholder, as in name%04d.png, a folder, "
                f"or a video ({' '.join(VIDEOS)})"
            )
        options.check_output(output, IMAGES, [scene])
        return cls(output.parent, output.name)

    def path(self, number: int) -> Path:
        """Return the path of a frame."""
        name = FRAME_NUMBER.sub(lambda found: found[0] % number, self.pattern)
        return self.folder / name

    def prepare(self, resume: bool) -> None:
        """Create the folder; reject one that may hold hours of work."""
        if self.video is not None and self.folder.exists() and not resume:
            raise BadInputError(
                f"{self.folder}: contains frames of an interrupted video; pass --resume to "
                "continue, or delete the folder"
            )
        with refuse(OSError, where=str(self.folder)):
            self.folder.mkdir(exist_ok=True)

    def is_whole(self, number: int, size: tuple[int, int]) -> bool:
        """Whether a frame exists, is readable, and has the right size."""
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
                "animation; delete it, or choose another --output"
            )
        return True

    def remove(self, numbers: tuple[int, ...]) -> None:
        """Delete the frames of a finished video."""
        for number in numbers:
            self.path(number).unlink(missing_ok=True)
        with contextlib.suppress(OSError):  # the folder holds other files
            self.folder.rmdir()
