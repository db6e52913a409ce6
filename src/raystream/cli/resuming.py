"""Pictures that are broken off and go on: the file of samples beside the picture."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from os import fspath
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from raystream.cli.messages import BadInputError, BrokenOffError, refuse, write_note
from raystream.core.errors import FileFormatError

if TYPE_CHECKING:
    from raystream.rendering.image import Image
    from raystream.rendering.sample_file import SampleFile

__all__ = ["Paths", "Resume", "checkpoint_beside", "keeping_samples"]

Resume = Annotated[
    bool,
    typer.Option(
        "--resume",
        help="Go on from the samples that lie beside the picture, if there are any.",
    ),
]


def checkpoint_beside(output: Path, resume: bool) -> Path:
    """The file of samples of a picture.

    Raises
    ------
    BadInputError
        If it is there already, and not to be used: it may hold the work of hours. Also if
        ``RAYSTREAM_CHECKPOINT_SECONDS`` is bad.
    """
    from raystream.rendering.progressive import checkpoint_seconds

    with refuse(ValueError):
        checkpoint_seconds()
    path = output.with_name(f"{output.name}.samples.npz")
    if path.exists() and not resume:
        raise BadInputError(
            f"{path}: keeps the samples of a picture that was broken off; go on from them with "
            "--resume, or remove it"
        )
    return path


@contextlib.contextmanager
def keeping_samples(checkpoint: Path | None) -> Iterator[SampleFile | None]:
    """Give the checkpoint of a picture; remove it at the block's end, or say where it is.

    A picture that is complete, and saved, before its first checkpoint is due leaves the disk
    alone. Where the block ends early, all samples are in the file.

    Parameters
    ----------
    checkpoint : Path or None
        None where nothing is kept.

    Yields
    ------
    SampleFile or None
        For `render`.

    Raises
    ------
    BrokenOffError
        After Ctrl-C, if there is such a file.
    BadInputError
        If it cannot be used, says what to do.
    """
    if checkpoint is None:
        yield None
        return
    from raystream.rendering.sample_file import SampleFile

    samples = SampleFile(checkpoint, at_end=False)
    try:
        try:
            yield samples
        except BaseException:
            with contextlib.suppress(OSError):  # what ended the block says more
                samples.save_held()
            raise
    except KeyboardInterrupt:
        if not checkpoint.exists():
            raise
        raise BrokenOffError(
            f"{checkpoint} keeps the samples: the same command with --resume goes on from them"
        ) from None
    except FileFormatError as error:
        if error.path != fspath(checkpoint):
            raise
        raise BadInputError(
            f"{error}; remove it to begin anew, or choose another --output"
        ) from error
    with contextlib.suppress(FileNotFoundError):
        checkpoint.unlink()


class Paths:
    """The progress of a picture: counts the samples that it begins with, and tells of them.

    Parameters
    ----------
    output : Path
    pixel_count : int
    shown : callable or None
        The progress bar.

    Attributes
    ----------
    samples_before : int
        Of each pixel, from the file of samples.
    """

    def __init__(
        self, output: Path, pixel_count: int, shown: Callable[[int, int], None] | None
    ) -> None:
        self.samples_before = 0
        self._output = output
        self._pixel_count = pixel_count
        self._shown = shown
        self._is_first = True

    def __call__(self, done: int, total: int) -> None:
        """Take a report: paths done, and paths."""
        if self._is_first:
            self._is_first = False
            self.samples_before = done // self._pixel_count
            if self.samples_before:
                write_note(f"{self._output}: goes on from {self.samples_before} samples")
        if self._shown is not None:
            self._shown(done, total)

    def count(self, image: Image) -> int:
        """Paths of this run."""
        return (image.figures["samples"] - self.samples_before) * self._pixel_count

    def figures(self, image: Image) -> dict[str, Any]:
        """For ``--json``: samples and error; null where one sample tells nothing of its error."""
        error = image.figures["error"]
        return {
            "samples_taken": image.figures["samples"],
            "samples_before": self.samples_before,
            "error": error if math.isfinite(error) else None,
        }

    def text(self, image: Image) -> str:
        """The same for people."""
        taken, error = image.figures["samples"], image.figures["error"]
        counts = f"{taken:,} sample{'s' if taken > 1 else ''}"
        return f"{counts}, error {error:.2%}" if math.isfinite(error) else counts
