"""Bundles: named arrays and a JSON header sent to workers, addressed by content.

A bundle is a mapping of arrays and a header of plain values. In transit it is a JSON manifest
and the bytes of each array, addressed by digest: arrays that a worker already has are not sent
again. Nothing is pickled.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream._version import __version__
from raystream.cluster.errors import ClusterError

#: Incremented with every change of the bundles' content.
FORMAT_VERSION = 1

_FORMAT = "raystream bundle"

#: Accepted dtype kinds: booleans, integers and floats.
_KINDS = "biuf"


def digest_of(array: NDArray[Any]) -> str:
    """Hash an array's numbers, shape and dtype."""
    digest = hashlib.sha256(f"{array.dtype.str}{array.shape}".encode())
    digest.update(np.ascontiguousarray(array).reshape(-1).view(np.uint8).data)
    return digest.hexdigest()


@dataclass(frozen=True)
class ArrayRef:
    """A reference to an array by its content.

    Attributes
    ----------
    digest : str
        Hash of its content; its name.
    dtype : str
        As NumPy writes it, including the byte order.
    shape : tuple of int
    """

    digest: str
    dtype: str
    shape: tuple[int, ...]

    @property
    def byte_count(self) -> int:
        """Size in bytes."""
        return math.prod(self.shape) * np.dtype(self.dtype).itemsize


@dataclass(frozen=True)
class Manifest:
    """The contents of a bundle.

    Attributes
    ----------
    text : str
        The whole manifest as JSON.
    header : mapping
        Plain values.
    arrays : mapping of str to ArrayRef
    """

    text: str
    header: Mapping[str, Any]
    arrays: Mapping[str, ArrayRef]

    @property
    def digest(self) -> str:
        """Name of the bundle."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    @classmethod
    def read(cls, text: str) -> Manifest:
        """Parse the JSON of a manifest.

        Raises
        ------
        ClusterError
            If it is malformed, or comes from another version of raystream.
        """
        try:
            fields = json.loads(text)
            if fields["format"] != _FORMAT:
                raise ValueError
            version = fields["version"], fields["raystream"]
            if version != (FORMAT_VERSION, __version__):
                raise ClusterError(
                    f"raystream {__version__} received work from raystream {version[1]!s:.20}: "
                    "install the same version on all machines of a cluster, or bits may differ"
                )
            refs = {
                str(name): ArrayRef(str(digest), str(dtype), tuple(map(int, shape)))
                for name, (digest, dtype, shape) in fields["arrays"].items()
            }
            if any(np.dtype(ref.dtype).kind not in _KINDS for ref in refs.values()):
                raise ValueError
            return cls(text, fields["header"], refs)
        except (AttributeError, KeyError, TypeError, ValueError, RecursionError):
            raise ClusterError("received data that is not a raystream bundle") from None


@dataclass(frozen=True)
class Bundle:
    """Arrays and plain values sent to workers together.

    Attributes
    ----------
    header : mapping
        JSON values, including NaN and infinities.
    arrays : mapping of str to ndarray
    """

    header: Mapping[str, Any]
    arrays: Mapping[str, NDArray[Any]]

    def manifest(self) -> Manifest:
        """Describe the bundle; hashes all of its arrays."""
        refs = {}
        for name, array in self.arrays.items():
            if array.dtype.kind not in _KINDS:
                raise TypeError(f"{name}: expected numbers, got dtype {array.dtype}")
            refs[name] = ArrayRef(digest_of(array), array.dtype.str, array.shape)
        fields = {
            "format": _FORMAT,
            "version": FORMAT_VERSION,
            "raystream": __version__,
            "header": self.header,
            "arrays": {n: [ref.digest, ref.dtype, ref.shape] for n, ref in refs.items()},
        }
        text = json.dumps(fields, sort_keys=True, default=_plain)
        return Manifest(text, self.header, refs)


def _plain(value: Any) -> Any:
    """Convert NumPy numbers to Python's."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    raise TypeError(f"cannot be sent to workers: {value!r:.60}")
