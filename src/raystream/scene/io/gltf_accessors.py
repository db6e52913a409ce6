"""glTF accessors: typed arrays in buffers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.scene.io.gltf_file import GltfFile, Node
from raystream.scene.io.text import shown

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}

#: Accessors without a buffer hold zeros: nothing else bounds their length.
MAX_ZERO_COUNT = 1 << 24


def read_accessor(file: GltfFile, index: int, widths: tuple[int, ...]) -> NDArray[Any]:
    """Read an accessor.

    Parameters
    ----------
    file : GltfFile
        The document.
    index : int
        Index of the accessor.
    widths : tuple of int
        Allowed numbers of components.

    Returns
    -------
    ndarray of shape (count, width)
        Normalised integers become float32 in [0, 1] or [-1, 1].

    Raises
    ------
    FileFormatError
        If it exceeds its buffer or has the wrong type.
    """
    accessor = file.entry("accessors", index)
    component = _COMPONENTS.get(file.integer(accessor, "componentType"))
    kind = accessor.get("type")
    width = _WIDTHS.get(kind, 0) if isinstance(kind, str) else 0
    if component is None or width not in widths:
        raise file.error(
            f"is damaged: accessor {index} has an unexpected type {shown(str(kind).encode())}"
        )
    count = file.integer(accessor, "count")
    view = file.index(accessor, "bufferView")
    offset = file.integer(accessor, "byteOffset", 0)
    if view is None:
        if count > MAX_ZERO_COUNT:
            raise file.error(f"is damaged: accessor {index} has {count:,} values and no buffer")
        values = np.zeros((count, width), component)
    else:
        values = _viewed(file, view, offset, count, width, component)
    if "sparse" in accessor:
        values = _with_sparse(file, file.child(accessor, "sparse"), values, component)
    return normalized(values) if accessor.get("normalized") is True else values


def _viewed(
    file: GltfFile, view: int, offset: int, count: int, width: int, component: str
) -> NDArray[Any]:
    buffer, stride = file.view(view)
    dtype = np.dtype(component)
    size = dtype.itemsize * width
    stride = stride or size
    if stride < size:
        raise file.error(f"is damaged: buffer view {view} has a stride of {stride} bytes")
    if count and offset + (count - 1) * stride + size > len(buffer):
        raise file.error(f"is damaged: {count:,} values exceed buffer view {view}")
    if count == 0:
        return np.empty((0, width), dtype)
    strided: NDArray[Any] = np.ndarray(
        (count, width), dtype, buffer, offset, (stride, dtype.itemsize)
    )
    return strided.copy()


def _with_sparse(
    file: GltfFile, sparse: Node, values: NDArray[Any], component: str
) -> NDArray[Any]:
    """Replace individual rows."""
    count = file.integer(sparse, "count")
    places, rows = file.child(sparse, "indices"), file.child(sparse, "values")
    index_type = _COMPONENTS.get(file.integer(places, "componentType"), "<f4")
    if index_type[1] != "u":
        raise file.error("is damaged: sparse indices are not unsigned")
    indices = _viewed(
        file,
        file.integer(places, "bufferView"),
        file.integer(places, "byteOffset", 0),
        count,
        1,
        index_type,
    )[:, 0]
    replaced = _viewed(
        file,
        file.integer(rows, "bufferView"),
        file.integer(rows, "byteOffset", 0),
        count,
        values.shape[1],
        component,
    )
    if count and int(indices.max()) >= len(values):
        raise file.error("is damaged: a sparse index exceeds its accessor")
    values[indices] = replaced
    return values


def normalized(values: NDArray[Any]) -> NDArray[Any]:
    """Map integers to [0, 1] or [-1, 1], float32; other numbers stay as they are."""
    if values.dtype.kind == "f":
        return values
    largest = float(np.iinfo(values.dtype).max)
    return np.maximum(values / largest, -1.0).astype(np.float32)
