"""Upload folder: a connection's uploaded files, limited in size, deleted at its end."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path
from typing import BinaryIO

#: Maximum files of one upload.
MAX_FILES = 256

#: Maximum files of one connection in transfer at once.
MAX_INCOMING = 4

#: Uploads kept per connection: the one being shown, the previous one as a fallback, and the one
#: in transfer.
MAX_UPLOADS = 3

#: Disk space left free by uploads, in bytes.
DISK_RESERVE = 256 << 20


_REMOVED = "the connection of this upload has ended, or newer uploads have replaced it"


class RejectedError(Exception):
    """A file that is rejected: too many, a duplicate, or its connection is gone."""


class TooLargeError(RejectedError):
    """A file that exceeds the upload's size limit."""


class BusyError(RejectedError):
    """Too many files in transfer at once."""


class FullError(RejectedError):
    """A file for which the disk has no space."""


class UploadFolder:
    """A temporary folder, created with the first file.

    It is private to this user. Each upload has its own subfolder, so that references in a
    model resolve among the files uploaded with it.

    Parameters
    ----------
    limit : int
        Maximum bytes of one upload, including all its files.

    Attributes
    ----------
    incoming_count : int
        Number of files in transfer.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.incoming_count = 0
        self._root: Path | None = None
        self._sizes: dict[str, dict[str, int]] = {}
        self._whole: set[tuple[str, str]] = set()
        self._opened: list[str] = []
        self._is_removed = False

    def find(self, upload: str, name: str) -> Path | None:
        """Find a completely uploaded file, to be opened; None if there is none.

        Parameters
        ----------
        upload, name : str
            Validated by `raystream.viewer.server.file_names`.
        """
        if self._root is None or (upload, name) not in self._whole:
            return None
        self._opened = [one for one in self._opened if one != upload] + [upload]
        return self._root / upload / name

    def receive(self, upload: str, name: str, claimed: int | None) -> IncomingFile:
        """Prepare to receive a file.

        Parameters
        ----------
        upload, name : str
            Validated by `raystream.viewer.server.file_names`.
        claimed : int or None
            Size announced by the client, if any.

        Raises
        ------
        RejectedError
            If the file is not accepted.
        """
        if self._is_removed:
            raise RejectedError(_REMOVED)
        if self.incoming_count >= MAX_INCOMING:
            raise BusyError(f"at most {MAX_INCOMING} files can be uploaded at once")
        sizes = self._sizes.get(upload, {})
        if name in sizes:
            raise RejectedError(f"{name}: exists already")
        if len(sizes) >= MAX_FILES:
            raise RejectedError(f"an upload may have at most {MAX_FILES} files")
        self.require_room(upload, claimed or 0)
        root = self._ensure_root()
        if upload not in self._sizes:
            self._forget_old()
            (root / upload).mkdir(mode=0o700)
            self._sizes[upload] = {}
        self._sizes[upload][name] = 0
        return IncomingFile(self, upload, name, root / upload / name)

    def require_room(self, upload: str, count: int) -> None:
        """Check that `count` more bytes fit in the upload's limit and on the disk.

        Raises
        ------
        TooLargeError
            If they exceed the upload's limit.
        FullError
            If the disk lacks space.
        """
        if sum(self._sizes.get(upload, {}).values()) + count > self.limit:
            raise TooLargeError(
                f"too large: an upload may have at most {self.limit:,} bytes (--upload-limit)"
            )
        place = self._root or Path(tempfile.gettempdir())
        if shutil.disk_usage(place).free < count + DISK_RESERVE:
            raise FullError("the viewer's disk is nearly full")

    def without_paths(self, text: str) -> str:
        """Remove the folder from paths in a text, leaving the names as uploaded."""
        if self._root is None:
            return text
        for upload in list(self._sizes):  # called from other threads
            text = text.replace(f"{self._root / upload}{os.sep}", "")
        return text

    def remove(self) -> None:
        """Delete all files; transfers in progress fail."""
        self._is_removed = True
        self._sizes.clear()
        self._whole.clear()
        if self._root is not None:
            shutil.rmtree(self._root, ignore_errors=True)

    def grow(self, upload: str, name: str, count: int) -> None:
        """Count received bytes of a file.

        Raises
        ------
        RejectedError
            If they exceed a limit, or the connection has ended.
        """
        if name not in self._sizes.get(upload, {}):
            raise RejectedError(_REMOVED)
        self.require_room(upload, count)
        self._sizes[upload][name] += count

    def complete(self, upload: str, name: str) -> None:
        """Mark a file as complete.

        Raises
        ------
        RejectedError
            If its upload has been removed meanwhile.
        """
        if name not in self._sizes.get(upload, {}):
            raise RejectedError(_REMOVED)
        self._whole.add((upload, name))

    def forget(self, upload: str, name: str) -> None:
        """Remove the record of an incomplete file."""
        self._sizes.get(upload, {}).pop(name, None)

    def _ensure_root(self) -> Path:
        if self._root is None:
            self._root = Path(tempfile.mkdtemp(prefix="raystream-view-"))
        return self._root

    def _forget_old(self) -> None:
        """Evict old uploads; the most recently opened ones last."""
        assert self._root is not None
        while len(self._sizes) >= MAX_UPLOADS:
            kept = self._opened[-2:]
            oldest = next(upload for upload in self._sizes if upload not in kept)
            del self._sizes[oldest]
            self._whole = {one for one in self._whole if one[0] != oldest}
            shutil.rmtree(self._root / oldest, ignore_errors=True)


class IncomingFile:
    """A file in transfer: a context manager that deletes incomplete files.

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

    def __enter__(self) -> IncomingFile:
        # Never overwrite a file or follow a link.
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
        try:
            self._file = os.fdopen(os.open(self._path, flags, 0o600), "wb")
        except OSError:
            self._folder.forget(self._upload, self._name)
            raise
        self._folder.incoming_count += 1
        return self

    def write(self, chunk: bytes) -> None:
        """Append bytes.

        Raises
        ------
        RejectedError
            If they exceed a limit, or the connection has ended.
        """
        assert self._file is not None
        self._folder.grow(self._upload, self._name, len(chunk))
        self._file.write(chunk)
        self.size += len(chunk)

    def finish(self) -> None:
        """Mark the file as complete."""
        assert self._file is not None
        self._file.close()
        self._folder.complete(self._upload, self._name)
        self._is_whole = True

    def __exit__(self, *error: object) -> None:
        assert self._file is not None
        self._folder.incoming_count -= 1
        self._file.close()
        if not self._is_whole:
            self._folder.forget(self._upload, self._name)
            self._path.unlink(missing_ok=True)
