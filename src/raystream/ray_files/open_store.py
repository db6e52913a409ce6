"""Open untrusted Zarr stores."""

from __future__ import annotations

import json
import math
import os
import zipfile
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any

from raystream.core.errors import FileFormatError, RaystreamError
from raystream.ray_files.checked_store import checked
from raystream.ray_files.codecs import Coding, find_coding
from raystream.ray_files.errors import require_zarr

__all__ = ["open_arrays"]

#: Longer metadata files are rejected before they are read.
MAX_METADATA_BYTES = 2**24

_MAX_ARRAYS = 1000

#: A filter may store numbers as another type; none is longer than this.
_MAX_ITEM_BYTES = 8

#: Metadata file of an array in Zarr v3 and v2.
_ARRAY_FILES = ("zarr.json", ".zarray")
_GROUP_FILES = ("zarr.json", ".zgroup", ".zattrs", ".zmetadata")


def open_arrays(path: str) -> dict[str, Any]:
    """Open the arrays of a group for reading.

    Parameters
    ----------
    path : str
        A folder, or a ``.zip`` file.

    Returns
    -------
    dict of str to zarr.Array
        All arrays directly in the group, by name; nested groups are ignored.

    Raises
    ------
    FileFormatError
        If the store does not exist, is damaged, or names a codec that is not supported.
    """
    if not os.path.exists(path):
        raise FileFormatError(path, "no such file or folder")
    require_zarr()
    import zarr

    try:
        files = _ZipFiles(path) if os.path.isfile(path) else _FolderFiles(path)
        for name in _GROUP_FILES:
            files.check(name)
        codings = files.arrays()
        if not codings and not any(map(files.has, _GROUP_FILES)):
            raise FileFormatError(path, "is not a Zarr store")
        limits: dict[str, int] = {}
        store = checked(files.store(), codings, limits, files.size)
        group = zarr.open_group(store, mode="r", use_consolidated=False)
        arrays: dict[str, Any] = {name: group[name] for name in codings}
        for name, array in arrays.items():
            limits[name] = math.prod(array.chunks) * _MAX_ITEM_BYTES
        return arrays
    except (RaystreamError, MemoryError):
        raise
    except zipfile.BadZipFile as error:
        raise FileFormatError(path, f"is not a complete .zip file ({error})") from None
    except Exception as error:  # damaged metadata can raise anything in Zarr
        reason = str(error).partition("\n")[0] or type(error).__name__
        raise FileFormatError(path, f"cannot be read as a Zarr store ({reason:.200})") from error


class _Files(ABC):
    """The files of a store, with their lengths before they are read."""

    def __init__(self, path: str) -> None:
        self.path = path

    def has(self, name: str) -> bool:
        return self.size(name) is not None

    @abstractmethod
    def size(self, name: str) -> int | None: ...

    @abstractmethod
    def read(self, name: str) -> bytes: ...

    @abstractmethod
    def folders(self) -> list[str]: ...

    def check(self, name: str) -> None:
        size = self.size(name)
        if size is not None and size > MAX_METADATA_BYTES:
            raise FileFormatError(self.path, f"{name} is {size / 1e6:,.0f} MB long: too long")

    def arrays(self) -> dict[str, Coding]:
        """Find how each array is stored, by name."""
        codings: dict[str, Coding] = {}
        for folder in sorted(self.folders()):
            self.check(f"{folder}/.zattrs")
            # If there are two metadata files, Zarr chooses which one counts.
            for name in _ARRAY_FILES:
                if self.has(f"{folder}/{name}"):
                    coding = self._coding(folder, f"{folder}/{name}")
                    if coding is not None:
                        codings.setdefault(folder, coding)
        if len(codings) > _MAX_ARRAYS:
            raise FileFormatError(self.path, f"holds {len(codings)} arrays: too many")
        return codings

    def _coding(self, folder: str, file: str) -> Coding | None:
        """Find how an array is stored; None if the file describes a group."""
        self.check(file)
        metadata = json.loads(self.read(file))
        if not isinstance(metadata, dict):
            raise FileFormatError(self.path, f"{file} describes no array")
        if metadata.get("node_type", "array") != "array":
            return None
        try:
            return find_coding(metadata)
        except ValueError as error:
            raise FileFormatError(self.path, f"array {folder!r} {error}") from None


class _FolderFiles(_Files):
    def size(self, name: str) -> int | None:
        try:
            return os.path.getsize(os.path.join(self.path, name))
        except FileNotFoundError:
            return None

    def read(self, name: str) -> bytes:
        return Path(self.path, name).read_bytes()

    def folders(self) -> list[str]:
        with os.scandir(self.path) as entries:
            return [entry.name for entry in entries if entry.is_dir()]

    def store(self) -> Any:
        from zarr.storage import LocalStore

        return LocalStore(self.path, read_only=True)


class _ZipFiles(_Files):
    def __init__(self, path: str) -> None:
        super().__init__(path)
        with zipfile.ZipFile(path) as archive:
            self._sizes = {member.filename: member.file_size for member in archive.infolist()}

    def size(self, name: str) -> int | None:
        return self._sizes.get(name)

    def read(self, name: str) -> bytes:
        with zipfile.ZipFile(self.path) as archive:
            return archive.read(name)

    def folders(self) -> list[str]:
        return list({name.partition("/")[0] for name in self._sizes if "/" in name})

    def store(self) -> Any:
        from zarr.storage import ZipStore

        return ZipStore(self.path, mode="r")
