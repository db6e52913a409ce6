"""glTF buffer views compressed by meshoptimizer (``EXT_meshopt_compression``), with meshopt."""

from __future__ import annotations

from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from raystream.scene.io.gltf_file import GltfFile

#: Most bytes per byte of compressed data: a block of up to 256 vertices has two bits for each of
#: their bytes (version 1 of the codec). It bounds the memory that a few bytes claim.
MAX_RATIO = 1024

#: Sizes of elements by mode: of indices, and of vertices, in steps of four.
_SIZES = {"TRIANGLES": (2, 4), "INDICES": (2, 4), "ATTRIBUTES": range(4, 257, 4)}

#: Filters and the sizes of their elements.
_FILTERS = {
    "NONE": range(4, 257, 4),
    "OCTAHEDRAL": (4, 8),
    "QUATERNION": (8,),
    "EXPONENTIAL": range(4, 257, 4),
    "COLOR": (4, 8),
}


def decoded_view(
    file: GltfFile, extension: dict[str, Any], content: memoryview, length: int
) -> bytes:
    """Decompress a buffer view.

    Parameters
    ----------
    file : GltfFile
    extension : dict
        Of the buffer view: ``mode``, ``filter``, ``count`` and ``byteStride``.
    content : memoryview
        The compressed bytes.
    length : int
        Bytes of the view.

    Raises
    ------
    FileFormatError
        If meshopt is not installed, or the data is damaged or does not fit the view.
    """
    count, size = file.integer(extension, "count"), file.integer(extension, "byteStride")
    mode, name = extension.get("mode"), extension.get("filter", "NONE")
    sizes = _SIZES.get(mode, ()) if isinstance(mode, str) else ()
    filtered = _FILTERS.get(name, ()) if isinstance(name, str) else ()
    if size not in sizes or (mode == "ATTRIBUTES" and size not in filtered):
        raise file.error("is damaged: a buffer view has no mode, filter or stride of meshopt")
    if count * size != length or count == 0 or (mode == "TRIANGLES" and count % 3):
        raise file.error(f"is damaged: {count:,} elements of meshopt do not fit their buffer view")
    if length > MAX_RATIO * len(content):
        raise file.error(f"is damaged: {len(content):,} bytes of meshopt claim {count:,} elements")
    meshopt = _meshopt(file)
    chosen = name if mode == "ATTRIBUTES" else None
    try:
        values = meshopt.decode_gltf_buffer(bytes(content), count, size, mode, chosen)
    except Exception as error:  # of several types
        raise file.error(f"is damaged: its meshopt data cannot be decoded ({error})") from None
    result = np.ascontiguousarray(values).tobytes()
    if len(result) != length:
        raise file.error("is damaged: its meshopt data does not fit its buffer view")
    return result


def _meshopt(file: GltfFile) -> ModuleType:
    try:
        import meshopt
    except ImportError:
        raise file.error(
            "is compressed with meshopt, which needs meshopt: pip install 'raystream[meshopt]'"
        ) from None
    return meshopt
