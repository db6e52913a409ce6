"""A store whose chunks are looked at before Zarr unpacks them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from raystream.zarr_queries.codecs import Coding
from raystream.zarr_queries.frames import check_frame

__all__ = ["checked"]

#: A chunk that does not get shorter by packing gets a little longer.
_SLACK = 2**16


def checked(
    store: Any,
    codings: dict[str, Coding],
    limits: dict[str, int],
    size_of: Callable[[str], int | None],
) -> Any:
    """Wrap a store, which is opened for reading.

    Parameters
    ----------
    store : zarr.abc.store.Store
    codings : dict of str to Coding
        Of the arrays, by name.
    limits : dict of str to int
        Bytes that a chunk may have, unpacked; of arrays that are not in it, yet, nothing is
        looked at.
    size_of : callable
        Gives the length of a file of the store, in bytes.

    Returns
    -------
    zarr.storage.WrapperStore
        Reading a chunk raises ValueError if it is longer than the limit, packed or not.
    """
    from zarr.abc.store import RangeByteRequest
    from zarr.storage import WrapperStore

    class CheckedStore(WrapperStore[Any]):
        async def get(self, key: str, prototype: Any, byte_range: Any = None) -> Any:
            name, _, chunk = key.partition("/")
            limit = limits.get(name)
            if limit is None or chunk == "zarr.json" or chunk.startswith(".z"):
                return await self._store.get(key, prototype, byte_range)
            compressor, trailer, is_sharded = codings[name]
            if isinstance(byte_range, RangeByteRequest):
                length = byte_range.end - byte_range.start
            else:
                length = 0 if is_sharded else size_of(key) or 0
            if length > limit + _SLACK:
                raise ValueError(f"a chunk takes {length:,} bytes, of at most {limit:,}")
            found = await self._store.get(key, prototype, byte_range)
            if found is not None and not is_sharded:
                frame = memoryview(found.as_numpy_array()).cast("B")
                check_frame(compressor, frame[: max(len(frame) - trailer, 0)], limit)
            return found

    return CheckedStore(store)
