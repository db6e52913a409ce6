"""Resuming interrupted renders: the checkpoint file beside the image."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from os import fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any

from raystream.cli.console import BadInputError, InterruptedRunError, refuse, write_note
from raystream.core.errors import FileFormatError

if TYPE_CHECKING:
    from raystream.cli.bars import Step
    from raystream.rendering.image import Image
    from raystream.rendering.sample_file import SampleFile


def checkpoint_path(output: Path, resume: bool) -> Path:
    """Return the path of an image's checkpoint.

    Raises
    ------
    BadInputError
        If it exists already and is not to be resumed: it may hold hours of work. Also if
        ``RAYSTREAM_CHECKPOINT_SECONDS`` is invalid.
    """
    from raystream.rendering.progressive import checkpoint_seconds

    with refuse(ValueError):
        checkpoint_seconds()
    path = output.with_name(f"{output.name}.samples.npz")
    if path.exists() and not resume:
        raise BadInputError(
            f"{path}: contains samples of an interrupted render; pass --resume to continue, or "
            "delete the file"
        )
    return path


@contextlib.contextmanager
def sample_checkpoint(checkpoint: Path | None) -> Iterator[SampleFile | None]:
    """Yield the checkpoint of an image; delete it at the end, or report where it is.

    An image that is complete and saved before its first checkpoint is due writes no
    checkpoint. If the block ends early, all samples are in the file.

    Parameters
    ----------
    checkpoint : Path or None
        None for no checkpoint.

    Yields
    ------
    SampleFile or None
        For `render`.

    Raises
    ------
    InterruptedRunError
        After Ctrl-C, if the file exists.
    BadInputError
        If the file cannot be used; says what to do.
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
            with contextlib.suppress(OSError):  # the error that ended the block matters more
                samples.save_held()
            raise
    except KeyboardInterrupt:
        if not checkpoint.exists():
            raise
        raise InterruptedRunError(
            f"{checkpoint} contains the samples so far; rerun with --resume to continue"
        ) from None
    except FileFormatError as error:
        if error.path != fspath(checkpoint):
            raise
        raise BadInputError(
            f"{error}; delete it to start over, or choose another --output"
        ) from error
    with contextlib.suppress(FileNotFoundError):
        checkpoint.unlink()


class PathProgress:
    """Progress callback of a render that counts and reports resumed samples.

    Parameters
    ----------
    output : Path
    pixel_count : int
    shown : Step or None
        The progress bar.
    tells_error : bool
        Whether people are told the error: in images without noise it is that of edges, which is
        large while nothing looks wrong.

    Attributes
    ----------
    samples_before : int
        Samples per pixel loaded from the checkpoint.
    """

    def __init__(
        self, output: Path, pixel_count: int, shown: Step | None, tells_error: bool
    ) -> None:
        self.samples_before = 0
        self._output = output
        self._pixel_count = pixel_count
        self._shown = shown
        self._tells_error = tells_error
        self._is_first = True

    def __call__(self, done: int, total: int) -> None:
        """Report progress: paths done, and paths in total."""
        if self._is_first:
            self._is_first = False
            self.samples_before = done // self._pixel_count
            if self.samples_before:
                write_note(f"{self._output}: resumed from {self.samples_before:,} samples")
        if self._shown is not None:
            self._shown(done, total)

    def show_error(self, image: Image) -> None:
        """Show the error so far in the progress bar."""
        text = self._error_text(image)
        if self._shown is not None and text:
            self._shown.describe(text)

    def count(self, image: Image) -> int:
        """Return the number of paths traced in this run."""
        samples: int = image.figures["samples"] - self.samples_before
        return samples * self._pixel_count

    def figures(self, image: Image) -> dict[str, Any]:
        """Return samples, error and passes, if there are any, for ``--json``.

        The error is null if one sample gives no estimate.
        """
        error = image.figures["error"]
        passes = image.figures.get("passes")
        return {
            **({} if passes is None else {"passes": passes}),
            "samples_taken": image.figures["samples"],
            "samples_before": self.samples_before,
            "error": error if math.isfinite(error) else None,
        }

    def text(self, image: Image) -> str:
        """Format samples and error for the console."""
        taken = image.figures["samples"]
        counts = f"{taken:,} sample{'s' if taken > 1 else ''}"
        return ", ".join(filter(None, (counts, self._error_text(image))))

    def _error_text(self, image: Image) -> str:
        """The error, or nothing if it is unknown or not to be told."""
        error = image.figures["error"]
        return f"error {error:.2%}" if self._tells_error and math.isfinite(error) else ""
