"""SharedFolder: array files that processes of one machine map into memory."""

from __future__ import annotations

import contextlib
import hashlib
import os
import secrets
import shutil
import tempfile
import uuid
import weakref
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.cluster.bundles import ArrayRef

_TOKEN = "token"

#: Share of a disk's free space left unused.
_SPARE = 0.1


def machine_name() -> str:
    """Return a name shared only by processes of this machine since it booted."""
    try:
        system = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:
        system = f"{uuid.getnode():x}"
    return hashlib.sha256(system.encode()).hexdigest()


class SharedFolder:
    """A temporary folder of ``.npy`` files, named by content and private to this user.

    It is deleted by `close`, or when this process ends. If it cannot be written, it stays
    empty, and arrays are sent as they are to other machines.

    Attributes
    ----------
    path : str
        Empty if there is no folder.
    token : str
        Content of the file ``token`` in the folder. A process that reads it there sees the same
        folder: the path alone could be a folder of another machine.
    """

    def __init__(self) -> None:
        self.path, self.token = "", secrets.token_hex(32)
        with contextlib.suppress(OSError):
            path = tempfile.mkdtemp(prefix="raystream-cluster-")
            (Path(path) / _TOKEN).write_text(self.token, encoding="ascii")
            self.path = path
        owner = os.getpid()
        self._end = weakref.finalize(self, _remove, self.path, owner)

    def add(self, digest: str, array: NDArray[Any]) -> None:
        """Write an array; skipped if it does not fit."""
        if not self.path:
            return
        place = Path(self.path) / f"{digest}.npy"
        try:
            if place.exists():
                return
            if array.nbytes > (1.0 - _SPARE) * shutil.disk_usage(self.path).free:
                return
            part = place.with_suffix(".part")
            with part.open("wb") as stream:
                np.save(stream, np.ascontiguousarray(array), allow_pickle=False)
            part.replace(place)  # atomically: no process maps half of it
        except OSError:
            return

    def remove(self, digest: str) -> None:
        """Delete an array; processes that have mapped it keep their mapping."""
        if self.path:
            with contextlib.suppress(OSError):  # Windows keeps mapped files until `close`
                (Path(self.path) / f"{digest}.npy").unlink(missing_ok=True)

    def close(self) -> None:
        """Delete the folder."""
        self._end()
        self.path = ""


def _remove(path: str, owner: int) -> None:
    if path and os.getpid() == owner:  # not a forked child that exits
        shutil.rmtree(path, ignore_errors=True)


def map_array(where: Mapping[str, str], ref: ArrayRef) -> NDArray[Any] | None:
    """Map an array of a shared folder into memory.

    Parameters
    ----------
    where : mapping
        ``machine``, ``path`` and ``token`` of a folder.
    ref : ArrayRef

    Returns
    -------
    ndarray or None
        Mapped copy-on-write: pages are shared until written to. None on another machine, or
        if the file does not exist here.
    """
    if not where.get("path") or where.get("machine") != machine_name():
        return None
    folder = Path(where["path"])
    try:
        if (folder / _TOKEN).read_text(encoding="ascii") != where.get("token"):
            return None
        mapped = np.load(folder / f"{ref.digest}.npy", mmap_mode="c", allow_pickle=False)
    except (OSError, ValueError, EOFError):  # empty arrays cannot be mapped
        return None
    if mapped.dtype.str != ref.dtype or mapped.shape != ref.shape:
        return None
    return np.asarray(mapped)
