"""What is missing, or cannot be written."""

from __future__ import annotations

import importlib.util
from os import PathLike, fspath

from raystream.core.errors import RaystreamError

__all__ = ["StoreWritingError", "require_zarr"]


class StoreWritingError(RaystreamError, OSError):
    """Hits that cannot be written, as on a full disk; what was written before is kept.

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
            f"{self.filename}: {self.strerror}; what is done is kept, and resuming goes on from it"
        )


def require_zarr() -> None:
    """Refuse to go on without the package.

    Raises
    ------
    RaystreamError
        If it is not installed.
    """
    if importlib.util.find_spec("zarr") is None:
        raise RaystreamError(
            "rays in Zarr stores need the package zarr: pip install 'raystream[zarr]'"
        )
