"""glTF primitives compressed by Draco (``KHR_draco_mesh_compression``), with DracoPy."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.scene.io.gltf_accessors import normalized
from raystream.scene.io.gltf_file import GltfFile, Node
from raystream.scene.io.instances import MAX_INSTANCED_TRIANGLES

#: Most triangles per byte: far beyond what Draco achieves, it bounds the memory that a few bytes
#: can claim.
MAX_TRIANGLES_PER_BYTE = 1024

# The header: magic, version (2 bytes), mesh or points, method, flags (2 bytes).
_MAGIC, _HEADER = b"DRACO", 11
_MESH, _SEQUENTIAL, _EDGEBREAKER = 1, 0, 1
_HAS_METADATA = 0x8000

_KINDS = {5120: "i1", 5121: "u1", 5122: "i2", 5123: "u2", 5125: "u4", 5126: "f4"}


class DracoMesh:
    """The triangles and attributes of a compressed primitive.

    Parameters
    ----------
    file : GltfFile
    primitive : dict
        With the extension.

    Attributes
    ----------
    faces : ndarray of shape (F, 3), int64
        Any indices.

    Raises
    ------
    FileFormatError
        If DracoPy is not installed, or the data is damaged or does not fit its accessors.
    """

    def __init__(self, file: GltfFile, primitive: Node, extension: Node) -> None:
        self._file = file
        self._accessors = file.child(primitive, "attributes")
        self._ids = file.child(extension, "attributes")
        draco = _draco(file)
        content = bytes(file.view(file.integer(extension, "bufferView"))[0])
        declared = file.index(primitive, "indices")
        count = _triangle_count(file, content)
        if declared is not None and file.integer(file.entry("accessors", declared), "count") != (
            3 * count
        ):
            raise file.error(
                f"is damaged: {count:,} triangles of Draco data do not fit its indices"
            )
        try:
            mesh = draco.decode(content)
            self._attributes = {int(one["unique_id"]): one["data"] for one in mesh.attributes}
            self.faces = np.asarray(mesh.faces).astype(np.int64).reshape(-1, 3)
        except MemoryError:
            raise
        except Exception as error:  # DracoPy raises several types for damaged data
            reason = " ".join(str(error).split())[:100]
            raise file.error(f"is damaged: its Draco data cannot be decoded ({reason})") from None

    def attribute(self, name: str) -> NDArray[Any] | None:
        """The values of an attribute, as `read_accessor` returns them; None if it is not here."""
        file = self._file
        number = file.index(self._ids, name)
        if number is None:
            return None
        accessor = file.entry("accessors", file.integer(self._accessors, name))
        values = self._attributes.get(number)
        if values is None or np.ndim(values) != 2:
            raise file.error(f"is damaged: its Draco data has no attribute {number}")
        array = np.asarray(values)
        kind = _KINDS.get(file.integer(accessor, "componentType"))
        if kind is None or len(array) != file.integer(accessor, "count"):
            raise file.error(f"is damaged: {name} of its Draco data does not fit its accessor")
        if array.dtype != np.dtype(kind):
            with np.errstate(all="ignore"):
                array = array.astype(kind)
            if not np.array_equal(array, values):
                raise file.error(f"is damaged: {name} of its Draco data does not fit its accessor")
        return normalized(array) if accessor.get("normalized") is True else array


def _triangle_count(file: GltfFile, content: bytes) -> int:
    """Read the number of triangles from the header, before anything is allocated."""
    if len(content) < _HEADER or content[:5] != _MAGIC:
        raise file.error("is damaged: its Draco data has no header")
    if content[7] != _MESH or content[8] not in (_SEQUENTIAL, _EDGEBREAKER):
        raise file.error("is damaged: its Draco data holds no triangles")
    if content[5:7] != b"\x02\x02" or int.from_bytes(content[9:11], "little") & _HAS_METADATA:
        raise file.error("has Draco data of another version than 2.2, or with metadata")
    place = _HEADER
    if content[8] == _EDGEBREAKER:  # the traversal's kind, and the number of vertices
        _, place = _varint(content, place + 1)
    count, _ = _varint(content, place)
    if count > min(MAX_INSTANCED_TRIANGLES, MAX_TRIANGLES_PER_BYTE * len(content)):
        raise file.error(
            f"is damaged: {len(content):,} bytes of Draco data claim {count:,} triangles"
        )
    return count


def _varint(content: bytes, place: int) -> tuple[int, int]:
    """Read a number, seven bits a byte, the lowest first; and the place after it."""
    value = 0
    for k, byte in enumerate(content[place : place + 5]):
        value |= (byte & 0x7F) << (7 * k)
        if byte < 0x80:
            return value, place + k + 1
    return 1 << 35, place  # more than any mesh has


def _draco(file: GltfFile) -> ModuleType:
    try:
        import DracoPy
    except ImportError:
        raise file.error(
            "is compressed with Draco, which needs DracoPy: pip install 'raystream[draco]'"
        ) from None
    return DracoPy
