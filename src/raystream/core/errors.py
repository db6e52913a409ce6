"""The errors that bad input raises: one line each, naming the file or argument and what to do."""

from __future__ import annotations

from os import PathLike, fspath

__all__ = ["FileFormatError", "RaystreamError", "RaystreamWarning"]


class RaystreamError(Exception):
    """Base of every error that raystream raises for bad input other than arguments.

    Bad arguments (arrays, options) raise ``ValueError`` or ``TypeError`` as NumPy does.
    """


class FileFormatError(RaystreamError, ValueError):
    """A file that is damaged, hostile, empty or of another format.

    Parameters
    ----------
    path : str or path
        The file at fault.
    reason : str
        What is wrong and, where it helps, what to do; one line.
    """

    def __init__(self, path: str | PathLike[str], reason: str) -> None:
        self.path = fspath(path)
        self.reason = reason
        super().__init__(f"{self.path}: {reason}")


class RaystreamWarning(UserWarning):
    """Input that was used only in part, such as a mesh with triangles that had to be skipped."""
