"""A store that checks the size of chunks before Zarr decompresses them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from raystream.ray_files.codecs import Coding
from raystream.ray_files.compressed_chunks import check_chunk

__all__ = ["checked"]

#: Incompressible chunks grow slightly when compressed.
_SLACK = 2**16


def checked(
    store: Any,
    codings: dict[str, Coding],
    limits: dict[str, int],
    size_of: Callable[[str], int | None],
) -> Any:
    """Wrap a store that is open for reading.

    Parameters
    ----------
    store : zarr.abc.store.Store
    codings : dict of str to Coding
        Codings of the arrays, by name.
    limits : dict of str to int
        Maximum decompressed bytes per chunk; arrays that are not listed (yet) are not checked.
    size_of : callable
        Returns the length of a file in the store, in bytes.

    Returns
    -------
    zarr.storage.WrapperStore
        Reading a chunk raises ValueError if it exceeds the limit, compressed or not.
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
                raise ValueError(f"a chunk has {length:,} bytes; the limit is {limit:,}")
            found = await self._store.get(key, prototype, byte_range)
            if found is not None and not is_sharded:
                frame = memoryview(found.as_numpy_array()).cast("B")
                check_chunk(compressor, frame[: max(len(frame) - trailer, 0)], limit)
            return found

    return CheckedStore(store)
