"""CheckpointArrays: the arrays of a checkpoint file, validated, and the identity of its image."""

from __future__ import annotations

import json
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError

#: Longest identity: it is shown in error messages.
_MAX_BYTES = 1 << 16

_SHOWN = 60


def identity_bytes(identity: str) -> NDArray[np.uint8]:
    """An identity as bytes, for a file of arrays.

    Raises
    ------
    TypeError
        If it is not text.
    ValueError
        If it is longer than 64 KiB.
    """
    if not isinstance(identity, str):
        raise TypeError(f"identity: expected text, got {type(identity).__name__}")
    encoded = identity.encode("utf-8", "backslashreplace")
    if len(encoded) > _MAX_BYTES:
        raise ValueError(f"identity: expected at most {_MAX_BYTES} bytes, got {len(encoded)}")
    return np.frombuffer(encoded, np.uint8)


class CheckpointArrays:
    """The arrays of a checkpoint file, validated on access.

    Parameters
    ----------
    path : str or path
        For error messages.
    arrays : dict of str to ndarray
    """

    def __init__(self, path: str | PathLike[str], arrays: dict[str, NDArray[Any]]) -> None:
        self.path = path
        self.arrays = arrays

    def check_identity(self, identity: str) -> None:
        """Check that the checkpoint is of this image.

        Parameters
        ----------
        identity : str
            Of the image. If both are JSON objects, the error names the differing keys.

        Raises
        ------
        FileFormatError
            If the file has another identity.
        """
        length = self._array("identity").size
        found = self.take("identity", (length,), np.uint8)
        if np.array_equal(found, identity_bytes(identity)):
            return
        other = found[:_MAX_BYTES].tobytes().decode("utf-8", "replace")
        theirs, ours = _fields(other), _fields(identity)
        reason = f"{_short(other)!r}, not {_short(identity)!r}"
        if theirs is not None and ours is not None:
            keys = sorted({*theirs, *ours})
            differing = [key for key in keys if theirs.get(key) != ours.get(key)]
            reason = f"{_short(', '.join(differing))} differ" if differing else reason
        raise FileFormatError(self.path, f"is a checkpoint of another image ({reason})")

    def take(
        self, name: str, shape: tuple[int, ...], dtype: type[Any], least: float = -np.inf
    ) -> NDArray[Any]:
        """An array of finite numbers, of a given shape and dtype, none below `least`.

        Raises
        ------
        FileFormatError
            If it is missing or invalid.
        """
        array = self._array(name)
        if array.shape != shape or array.dtype != dtype:
            found = f"{array.dtype} of shape {array.shape}"
            raise FileFormatError(self.path, f"array {name!r} is {found}, expected {shape}")
        if not np.isfinite(array).all() or (array.size and array.min() < least):
            raise FileFormatError(self.path, f"array {name!r} holds numbers that cannot be sums")
        return array

    def _array(self, name: str) -> NDArray[Any]:
        if name not in self.arrays:
            raise FileFormatError(self.path, f"is not a checkpoint: it lacks the array {name!r}")
        return self.arrays[name]


def _fields(identity: str) -> dict[str, Any] | None:
    try:
        fields = json.loads(identity)
    except (ValueError, RecursionError):
        return None
    return fields if isinstance(fields, dict) else None


def _short(text: str) -> str:
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
