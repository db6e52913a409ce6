"""Reading untrusted ``.npz`` files, and writing them.

NumPy's own reader trusts an array's header: a file of a few bytes can make it allocate
terabytes, and object arrays are unpickled. Here every header is compared with the bytes that
follow it before anything is allocated, and only plain numbers are read.
"""

from __future__ import annotations

import os
import zipfile
from collections.abc import Mapping
from os import PathLike, fspath
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.atomic_write import atomic_write
from raystream.core.errors import FileFormatError
from raystream.core.memory import available_memory

#: More arrays are refused before they are read: each takes about 50 us.
_MAX_MEMBERS = 1 << 18
_KINDS = "biuf"


def read_npz(path: str | PathLike[str]) -> dict[str, NDArray[Any]]:
    """Read all arrays of an ``.npz`` file.

    Parameters
    ----------
    path : str or path

    Returns
    -------
    dict of str to ndarray
        Arrays of booleans, integers or floats, by name.

    Raises
    ------
    FileFormatError
        If the file does not exist, is not an ``.npz`` file, is damaged, claims more than it
        holds or than fits into memory, or holds anything but numbers.
    """
    path = fspath(path)
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            _check_size(path, members)
            arrays = {}
            for member in members:
                with archive.open(member) as stream:
                    name = member.filename.removesuffix(".npy")
                    arrays[name] = _read_member(path, name, stream, member.file_size)
            return arrays
    except FileFormatError:
        raise
    except FileNotFoundError:
        raise FileFormatError(path, "no such file") from None
    except IsADirectoryError:
        raise FileFormatError(path, "is a folder, not a file") from None
    except zipfile.BadZipFile as error:
        reason = (
            "is empty" if os.path.getsize(path) == 0 else f"is not a complete .npz file ({error})"
        )
        raise FileFormatError(path, reason) from None
    except (OSError, EOFError, ValueError, NotImplementedError, RuntimeError) as error:
        raise FileFormatError(path, f"cannot be read ({error})") from error
    except Exception as error:  # zlib and lzma have errors of their own
        raise FileFormatError(path, f"is damaged ({error})") from error


def _check_size(path: str, members: list[zipfile.ZipInfo]) -> None:
    if len(members) > _MAX_MEMBERS:
        raise FileFormatError(path, f"holds {len(members)} arrays; at most {_MAX_MEMBERS} are read")
    claimed = sum(member.file_size for member in members)
    available = available_memory()
    if available is not None and claimed > available:
        raise FileFormatError(path, f"claims {claimed / 1e9:.1f} GB, more than memory can hold")


def _read_member(path: str, name: str, stream: IO[bytes], size: int) -> NDArray[Any]:
    version = np.lib.format.read_magic(stream)
    if version == (1, 0):
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream)
    elif version == (2, 0):
        shape, fortran, dtype = np.lib.format.read_array_header_2_0(stream)
    else:
        raise FileFormatError(path, f"array {name!r} has an unknown header")
    if dtype.kind not in _KINDS:
        raise FileFormatError(path, f"array {name!r} has dtype {dtype}; expected numbers")
    byte_count = dtype.itemsize
    for length in shape:
        byte_count *= int(length)
    if any(length < 0 for length in shape) or byte_count > size:
        raise FileFormatError(path, f"array {name!r} claims more than the file holds")
    content = stream.read(byte_count)
    stream.read(1)  # at the end, zipfile compares the checksum
    if len(content) != byte_count:
        raise FileFormatError(path, f"array {name!r} is truncated")
    array = np.frombuffer(bytearray(content), dtype).reshape(shape, order="F" if fortran else "C")
    return array.astype(dtype.newbyteorder("="), copy=False)


def write_npz(path: str | PathLike[str], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays to an ``.npz`` file, atomically.

    Parameters
    ----------
    path : str or path
        Ends in ``.npz``.
    arrays : mapping of str to ndarray

    Raises
    ------
    ValueError
        If the name does not end in ``.npz``.
    OSError
        If the file cannot be written; an existing file stays as it was.
    """
    target = Path(path)
    if target.suffix.lower() != ".npz":
        raise ValueError(f"{target}: the name must end in .npz")
    with atomic_write(target) as temporary, temporary.open("wb") as stream:
        np.savez(stream, **arrays)  # type: ignore[arg-type]
