"""SharedFolder: arrays in files that processes of one machine map into their memory."""

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

from raystream.cluster.parcels import ArrayPlace

__all__ = ["SharedFolder", "machine_name", "map_array"]

_TOKEN = "token"

#: Part of a disk's free space that is left to others.
_SPARE = 0.1


def machine_name() -> str:
    """A name that only processes of this machine, since it was started, give."""
    try:
        system = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:
        system = f"{uuid.getnode():x}"
    return hashlib.sha256(system.encode()).hexdigest()


class SharedFolder:
    """A temporary folder of ``.npy`` files, named by their content, for this user alone.

    It is removed by `close`, or when this process ends. Where nothing can be written, it stays
    empty: arrays then travel as they do to other machines.

    Attributes
    ----------
    path : str
        Empty if there is none.
    token : str
        What the file ``token`` in it says. Who can read it there has the same file before him:
        a name alone could be another machine's folder.
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
        """Write an array; one that does not fit is left out."""
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
            part.replace(place)  # as a whole: nobody maps half of it
        except OSError:
            return

    def remove(self, digest: str) -> None:
        """Remove an array; who has mapped it keeps it."""
        if self.path:
            with contextlib.suppress(OSError):  # Windows keeps what is mapped, until `close`
                (Path(self.path) / f"{digest}.npy").unlink(missing_ok=True)

    def close(self) -> None:
        """Remove the folder."""
        self._end()
        self.path = ""


def _remove(path: str, owner: int) -> None:
    if path and os.getpid() == owner:  # not a forked child at its end
        shutil.rmtree(path, ignore_errors=True)


def map_array(where: Mapping[str, str], place: ArrayPlace) -> NDArray[Any] | None:
    """Map an array of a shared folder into memory.

    Parameters
    ----------
    where : mapping
        ``machine``, ``path`` and ``token`` of a folder.
    place : ArrayPlace

    Returns
    -------
    ndarray or None
        Its pages are shared until somebody writes to them, and then one's own. None if this is
        another machine, or there is no such file here.
    """
    if not where.get("path") or where.get("machine") != machine_name():
        return None
    folder = Path(where["path"])
    try:
        if (folder / _TOKEN).read_text(encoding="ascii") != where.get("token"):
            return None
        mapped = np.load(folder / f"{place.digest}.npy", mmap_mode="c", allow_pickle=False)
    except (OSError, ValueError, EOFError):  # empty arrays cannot be mapped
        return None
    if mapped.dtype.str != place.dtype or mapped.shape != place.shape:
        return None
    return np.asarray(mapped)
