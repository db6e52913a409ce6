"""Errors for bad input: one line each, naming the file or argument and the remedy."""

from __future__ import annotations

from os import PathLike, fspath


class RaystreamError(Exception):
    """Base of every error that raystream raises for bad input other than arguments.

    Bad arguments (arrays, options) raise ``ValueError`` or ``TypeError`` as NumPy does.
    """


class FileFormatError(RaystreamError, ValueError):
    """A file that is damaged, malicious, empty or of another format.

    Parameters
    ----------
    path : str or path
        The file at fault.
    reason : str
        The fault and, if useful, the remedy; one line.
    """

    def __init__(self, path: str | PathLike[str], reason: str) -> None:
        self.path = fspath(path)
        self.reason = reason
        super().__init__(f"{self.path}: {reason}")


class LoopLimitError(RaystreamError, RuntimeError):
    """A loop over streams that did not end within its limit.

    Parameters
    ----------
    name : str
        The loop.
    limit : int
        Rounds that it ran.
    written_count : int
        Records that the last round still wrote.
    """

    def __init__(self, name: str, limit: int, written_count: int) -> None:
        self.name = name
        self.limit = limit
        self.written_count = written_count
        super().__init__(name, limit, written_count)

    def __str__(self) -> str:
        return (
            f"{self.name}: still wrote {self.written_count:,} records in round {self.limit:,}; "
            "return None for records that are done, or raise limit="
        )


class RaystreamWarning(UserWarning):
    """Input that is only partly used, such as a mesh with triangles that are skipped."""
