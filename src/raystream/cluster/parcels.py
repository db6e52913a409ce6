"""Parcels: what travels to workers, as plain arrays and a text, named by its content.

A parcel is a mapping of arrays and a header of plain values. On the way it is a manifest, which
is JSON, and the arrays' bytes, each under the digest of its content: what a worker has already
is not sent again. Nothing of it is pickled.
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

__all__ = ["ArrayPlace", "Manifest", "Parcel", "digest_of"]

#: Raised by every change of what parcels hold.
FORMAT_VERSION = 1

_FORMAT = "raystream parcel"

#: Kinds of dtypes that travel: booleans, integers and floats.
_KINDS = "biuf"


def digest_of(array: NDArray[Any]) -> str:
    """A name that only arrays of the same numbers, shape and dtype have."""
    digest = hashlib.sha256(f"{array.dtype.str}{array.shape}".encode())
    digest.update(np.ascontiguousarray(array).reshape(-1).view(np.uint8).data)
    return digest.hexdigest()


@dataclass(frozen=True)
class ArrayPlace:
    """An array that is somewhere else.

    Attributes
    ----------
    digest : str
        Of its content; its name.
    dtype : str
        As NumPy writes it, with the byte order.
    shape : tuple of int
    """

    digest: str
    dtype: str
    shape: tuple[int, ...]

    @property
    def byte_count(self) -> int:
        """Its size."""
        return math.prod(self.shape) * np.dtype(self.dtype).itemsize


@dataclass(frozen=True)
class Manifest:
    """What a parcel holds.

    Attributes
    ----------
    text : str
        All of it, as JSON.
    header : mapping
        Plain values.
    arrays : mapping of str to ArrayPlace
    """

    text: str
    header: Mapping[str, Any]
    arrays: Mapping[str, ArrayPlace]

    @property
    def digest(self) -> str:
        """The name of the parcel."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    @classmethod
    def read(cls, text: str) -> Manifest:
        """Read the JSON of a manifest.

        Raises
        ------
        ClusterError
            If it is none, or one of another version of raystream.
        """
        try:
            fields = json.loads(text)
            if fields["format"] != _FORMAT:
                raise ValueError
            version = fields["version"], fields["raystream"]
            if version != (FORMAT_VERSION, __version__):
                raise ClusterError(
                    f"raystream {__version__} was sent work of raystream {version[1]!s:.20}: "
                    "install the same version on all machines of a cluster, or bits may differ"
                )
            places = {
                str(name): ArrayPlace(str(digest), str(dtype), tuple(map(int, shape)))
                for name, (digest, dtype, shape) in fields["arrays"].items()
            }
            if any(np.dtype(place.dtype).kind not in _KINDS for place in places.values()):
                raise ValueError
            return cls(text, fields["header"], places)
        except (AttributeError, KeyError, TypeError, ValueError, RecursionError):
            raise ClusterError("a parcel arrived that is none of raystream's") from None


@dataclass(frozen=True)
class Parcel:
    """Arrays and plain values that go to workers together.

    Attributes
    ----------
    header : mapping
        What JSON can hold; NaN and infinities, too.
    arrays : mapping of str to ndarray
    """

    header: Mapping[str, Any]
    arrays: Mapping[str, NDArray[Any]]

    def manifest(self) -> Manifest:
        """Describe it; all of its arrays are read for that."""
        places = {}
        for name, array in self.arrays.items():
            if array.dtype.kind not in _KINDS:
                raise TypeError(f"{name}: expected numbers, got dtype {array.dtype}")
            places[name] = ArrayPlace(digest_of(array), array.dtype.str, array.shape)
        fields = {
            "format": _FORMAT,
            "version": FORMAT_VERSION,
            "raystream": __version__,
            "header": self.header,
            "arrays": {n: [place.digest, place.dtype, place.shape] for n, place in places.items()},
        }
        text = json.dumps(fields, sort_keys=True, default=_plain)
        return Manifest(text, self.header, places)


def _plain(value: Any) -> Any:
    """NumPy's numbers as Python's."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    raise TypeError(f"cannot travel to workers: {value!r:.60}")
