"""CompileLock: when several processes need the same kernel, one compiles it and the others wait.

A lock is one byte of a file. The system releases it when the process ends, however it ends, so
nothing has to be cleaned up. The lock is advisory: if the file cannot be locked, or another
process holds the lock for too long, the kernel is compiled without it.
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

#: Seconds to wait for another process; the longest kernels compile in some tens of seconds.
TIMEOUT = 180.0

#: Seconds between two attempts.
PAUSE = 0.02

_HELD = (errno.EACCES, errno.EAGAIN, errno.EDEADLK)


class CompileLock:
    """The locks that this process holds in one folder.

    Parameters
    ----------
    folder : Path
        Where the file is, or is made; shared by the processes.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / "locks"
        # One descriptor until the end: closing any of them would release every lock (POSIX).
        self._file: int | None = None

    def acquire(self, name: str, timeout: float | None = None) -> bool:
        """Wait until no other process holds the lock of this name, and acquire it.

        Parameters
        ----------
        name : str
        timeout : float, optional
            Seconds to wait [default: `TIMEOUT`].

        Returns
        -------
        bool
            Whether it was acquired; False after that time, or if the file cannot be locked.
        """
        try:
            if self._file is None:
                self._path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
                self._file = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o600)
            end = time.monotonic() + (TIMEOUT if timeout is None else timeout)
            while not _lock(self._file, _place(name)):
                if time.monotonic() >= end:
                    return False
                time.sleep(PAUSE)
        except OSError:  # a folder that cannot be written, or a file system without locks
            return False
        return True

    def release(self, name: str) -> None:
        """Release the lock; does nothing if it is not held."""
        try:
            if self._file is not None:
                _unlock(self._file, _place(name))
        except OSError:
            pass


def _place(name: str) -> int:
    """The byte of a name; two names may share one, and then share the lock."""
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
