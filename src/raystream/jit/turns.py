"""Turns: of several processes that need one compiled kernel, one makes it and the others wait.

A turn is a lock on one byte of a file. The system lets go of it when the process ends, however
it ends, so that nothing is left over to be cleared away. Turns are a courtesy: where the file
cannot be locked, or another process keeps its turn for too long, work goes on without.
"""

from __future__ import annotations

import errno
import hashlib
import os
import sys
import time
from pathlib import Path

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

__all__ = ["Turns"]

#: Seconds to wait for another process; the longest kernels compile in some tens of seconds.
PATIENCE = 180.0

#: Seconds between two looks.
PAUSE = 0.02

_HELD = (errno.EACCES, errno.EAGAIN, errno.EDEADLK)


class Turns:
    """The turns that this process takes in one folder.

    Parameters
    ----------
    folder : Path
        Where the file is, or is made; shared by the processes.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / "turns"
        # One descriptor until the end: to close any of them would end all turns (POSIX).
        self._file: int | None = None

    def take(self, name: str, patience: float | None = None) -> bool:
        """Wait until no other process has the turn of this name, and take it.

        Parameters
        ----------
        name : str
        patience : float, optional
            Seconds to wait; else `PATIENCE`.

        Returns
        -------
        bool
            Whether it was taken; False if it cannot be or was waited for that long.
        """
        try:
            if self._file is None:
                self._path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
                self._file = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o600)
            end = time.monotonic() + (PATIENCE if patience is None else patience)
            while not _lock(self._file, _place(name)):
                if time.monotonic() >= end:
                    return False
                time.sleep(PAUSE)
        except OSError:  # a folder that cannot be written, or a file system without locks
            return False
        return True

    def give(self, name: str) -> None:
        """Let the next process have the turn; does nothing where there is none."""
        try:
            if self._file is not None:
                _unlock(self._file, _place(name))
        except OSError:
            pass


def _place(name: str) -> int:
    """The byte of a name. Two names may share it: their turns are then one."""
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:4]) & 0x7FFFFFFF


if sys.platform == "win32":

    def _lock(file: int, place: int) -> bool:
        os.lseek(file, place, os.SEEK_SET)
        try:
            msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
        except OSError as error:
            if error.errno in _HELD:
                return False
            raise
        return True

    def _unlock(file: int, place: int) -> None:
        os.lseek(file, place, os.SEEK_SET)
        msvcrt.locking(file, msvcrt.LK_UNLCK, 1)

else:

    def _lock(file: int, place: int) -> bool:
        try:
            fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, place)
        except OSError as error:
            if error.errno in _HELD:
                return False
            raise
        return True

    def _unlock(file: int, place: int) -> None:
        fcntl.lockf(file, fcntl.LOCK_UN, 1, place)
