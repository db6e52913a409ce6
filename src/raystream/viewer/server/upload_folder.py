"""Upload folder: the files that one connection has sent, bounded, gone when it ends."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

__all__ = [
    "MAX_FILES",
    "ArrivingFile",
    "BusyError",
    "FullError",
    "RefusedError",
    "TooLargeError",
    "UploadFolder",
]

#: Files that one upload may consist of.
MAX_FILES = 256

#: Files of one connection that arrive at once.
MAX_ARRIVING = 4

#: Uploads that are kept for a connection: the one that it shows, the one before, in case that
#: the new one cannot be shown, and the one that arrives.
MAX_UPLOADS = 3

#: Bytes of the disk that uploads leave free.
DISK_RESERVE = 256 << 20


_GIVEN_UP = "the connection of this upload has ended, or has sent others since"


class RefusedError(Exception):
    """A file that may not come: too many, there already, or its connection is gone."""


class TooLargeError(RefusedError):
    """A file with which an upload would have too many bytes."""


class BusyError(RefusedError):
    """A file too many at once."""


class FullError(RefusedError):
    """A file for which the disk has no room."""


class UploadFolder:
    """A temporary folder, made when the first file comes.

    Nobody but this user can look into it. Each upload has a folder of its own in it, so that
    what a model refers to is looked for among the files that came with it.

    Parameters
    ----------
    limit : int
        Bytes of one upload, all its files together.

    Attributes
    ----------
    arriving_count : int
        Files that have begun to come.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.arriving_count = 0
        self._root: Path | None = None
        self._sizes: dict[str, dict[str, int]] = {}
        self._whole: set[tuple[str, str]] = set()
        self._opened: list[str] = []
        self._is_removed = False

    def find(self, upload: str, name: str) -> Path | None:
        """Find a file that has come as a whole, to be opened; None if there is none.

        Parameters
        ----------
        upload, name : str
            Checked by `raystream.viewer.server.names`.
        """
        if self._root is None or (upload, name) not in self._whole:
            return None
        self._opened = [one for one in self._opened if one != upload] + [upload]
        return self._root / upload / name

    def receive(self, upload: str, name: str, claimed: int | None) -> ArrivingFile:
        """Prepare for a file.

        Parameters
        ----------
        upload, name : str
            Checked by `raystream.viewer.server.names`.
        claimed : int or None
            Bytes that the client says will come, if it does.

        Raises
        ------
        RefusedError
            If the file cannot come.
        """
        if self._is_removed:
            raise RefusedError(_GIVEN_UP)
        if self.arriving_count >= MAX_ARRIVING:
            raise BusyError(f"at most {MAX_ARRIVING} files can arrive at once")
        sizes = self._sizes.get(upload, {})
        if name in sizes:
            raise RefusedError(f"{name}: is there already")
        if len(sizes) >= MAX_FILES:
            raise RefusedError(f"an upload may have {MAX_FILES} files at most")
        self.require_room(upload, claimed or 0)
        root = self._ensure_root()
        if upload not in self._sizes:
            self._forget_old()
            (root / upload).mkdir(mode=0o700)
            self._sizes[upload] = {}
        self._sizes[upload][name] = 0
        return ArrivingFile(self, upload, name, root / upload / name)

    def require_room(self, upload: str, count: int) -> None:
        """Refuse `count` bytes more than an upload may have, or than there is room for.

        Raises
        ------
        TooLargeError
            If there are too many for the upload.
        FullError
            If the disk would become too full.
        """
        if sum(self._sizes.get(upload, {}).values()) + count > self.limit:
            raise TooLargeError(
                f"too large: an upload may have {self.limit:,} bytes at most (--upload-limit)"
            )
        place = self._root or Path(tempfile.gettempdir())
        if shutil.disk_usage(place).free < count + DISK_RESERVE:
            raise FullError("no room: the disk of this viewer is nearly full")

    def without_place(self, text: str) -> str:
        """A text with files called as they were sent, not where they lie."""
        if self._root is None:
            return text
        for upload in list(self._sizes):  # from another thread than the one that adds
            text = text.replace(f"{self._root / upload}{os.sep}", "")
        return text

    def remove(self) -> None:
        """Remove all files; files that are still arriving end."""
        self._is_removed = True
        self._sizes.clear()
        self._whole.clear()
        if self._root is not None:
            shutil.rmtree(self._root, ignore_errors=True)

    def grow(self, upload: str, name: str, count: int) -> None:
        """Count bytes that have come for a file.

        Raises
        ------
        RefusedError
            If they are too many, or the connection has ended.
        """
        if name not in self._sizes.get(upload, {}):
            raise RefusedError(_GIVEN_UP)
        self.require_room(upload, count)
        self._sizes[upload][name] += count

    def complete(self, upload: str, name: str) -> None:
        """Say that a file has come as a whole.

        Raises
        ------
        RefusedError
            If its upload has been given up meanwhile.
        """
        if name not in self._sizes.get(upload, {}):
            raise RefusedError(_GIVEN_UP)
        self._whole.add((upload, name))

    def forget(self, upload: str, name: str) -> None:
        """Let go of a file that did not come as a whole."""
        self._sizes.get(upload, {}).pop(name, None)

    def _ensure_root(self) -> Path:
        if self._root is None:
            self._root = Path(tempfile.mkdtemp(prefix="raystream-view-"))
        return self._root

    def _forget_old(self) -> None:
        """Make room for one more upload; what was opened last goes last."""
        assert self._root is not None
        while len(self._sizes) >= MAX_UPLOADS:
            kept = self._opened[-2:]
            oldest = next(upload for upload in self._sizes if upload not in kept)
            del self._sizes[oldest]
            self._whole = {one for one in self._whole if one[0] != oldest}
            shutil.rmtree(self._root / oldest, ignore_errors=True)


class ArrivingFile:
    """A file while it comes: a context manager that removes what is not whole.

    Parameters
    ----------
    folder : UploadFolder
    upload, name : str
    path : Path
    """

    def __init__(self, folder: UploadFolder, upload: str, name: str, path: Path) -> None:
        self._folder = folder
        self._upload = upload
        self._name = name
        self._path = path
        self._file: BinaryIO | None = None
        self._is_whole = False
        self.size = 0

    def __enter__(self) -> ArrivingFile:
        # Never what is there already, nor through a link.
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
        try:
            self._file = os.fdopen(os.open(self._path, flags, 0o600), "wb")
        except OSError:
            self._folder.forget(self._upload, self._name)
            raise
        self._folder.arriving_count += 1
        return self

    def write(self, chunk: bytes) -> None:
        """Append bytes.

        Raises
        ------
        RefusedError
            If they are too many, or the connection has ended.
        """
        assert self._file is not None
        self._folder.grow(self._upload, self._name, len(chunk))
        self._file.write(chunk)
        self.size += len(chunk)

    def finish(self) -> None:
        """Say that the file is whole."""
        assert self._file is not None
        self._file.close()
        self._folder.complete(self._upload, self._name)
        self._is_whole = True

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        assert self._file is not None
        self._folder.arriving_count -= 1
        self._file.close()
        if not self._is_whole:
            self._folder.forget(self._upload, self._name)
            self._path.unlink(missing_ok=True)
