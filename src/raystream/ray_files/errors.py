"""Errors: a missing package, and hits that cannot be written."""

from __future__ import annotations

import importlib.util
from os import PathLike, fspath

from raystream.core.errors import RaystreamError


class StoreWriteError(RaystreamError, OSError):
    """Hits cannot be written, for example to a full disk; finished blocks are kept.

    Parameters
    ----------
    path : str or path
        The store.
    cause : OSError
    """

    def __init__(self, path: str | PathLike[str], cause: OSError) -> None:
        super().__init__(cause.errno, cause.strerror or str(cause), fspath(path))

    def __str__(self) -> str:
        return (
            f"{self.filename}: {self.strerror}; finished blocks are saved, and the query can resume"
        )


def require_zarr() -> None:
    """Check that the package is installed.

    Raises
    ------
    RaystreamError
        If it is not installed.
    """
    if importlib.util.find_spec("zarr") is None:
        raise RaystreamError(
            "rays in Zarr stores need the package zarr: pip install 'raystream[zarr]'"
        )
