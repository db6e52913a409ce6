"""glTF container: checked access to the JSON document and its buffers."""

from __future__ import annotations

import base64
import binascii
import json
import math
from pathlib import Path
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

from raystream.core.errors import FileFormatError
from raystream.scene.io.files import find_sibling, read_model_bytes
from raystream.scene.io.gltf_extensions import COMPRESSED, can_read
from raystream.scene.io.gltf_meshopt import decoded_view
from raystream.scene.io.text import shown

Node = dict[str, Any]

_GLB_MAGIC = b"glTF"
_JSON_CHUNK = 0x4E4F534A
_BINARY_CHUNK = 0x004E4942


#: Most numbers of morph targets and of skins, over a whole file: they may share a buffer, but are
#: stored separately.
MAX_DEFORMATION_NUMBERS = 1 << 26

#: Most bytes of compressed buffer views, each time that one is read: they may share their data.
MAX_DECODED_BYTES = 1 << 32


class GltfFile:
    """A glTF 2.0 document with its buffers.

    Every access checks the JSON type, so that a damaged file raises one `FileFormatError`.

    Parameters
    ----------
    path : Path
        A ``.gltf`` or ``.glb`` file.

    Attributes
    ----------
    path : Path
    root : dict
        The JSON document.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        content = read_model_bytes(path)
        self._binary: bytes | None = None
        text = self._chunks(content) if content[:4] == _GLB_MAGIC else content
        try:
            root = json.loads(text.decode("utf-8-sig"))
        except (ValueError, RecursionError):
            raise self.error("is not a glTF file: its JSON part cannot be read") from None
        if not isinstance(root, dict):
            raise self.error("is not a glTF file: its JSON part is not an object")
        self.root: Node = root
        self._buffers: dict[int, bytes] = {}
        self._decoded_bytes = 0
        self._number_count = 0
        self._check_version()

    def error(self, reason: str) -> FileFormatError:
        """Make the error for this file."""
        return FileFormatError(self.path, reason)

    def _chunks(self, content: bytes) -> bytes:
        """Split a GLB file; return the JSON and keep the binary chunk."""
        if len(content) < 20:
            raise self.error("is truncated: a GLB file has at least 20 bytes")
        version, length = (int.from_bytes(content[i : i + 4], "little") for i in (4, 8))
        if version != 2:
            raise self.error(f"GLB version {version} is not supported, only 2")
        if length > len(content):
            raise self.error(
                f"is truncated: it declares {length:,} bytes, but has {len(content):,}"
            )
        text, position = b"", 12
        while position + 8 <= length:
            size, kind = (
                int.from_bytes(content[position + i : position + i + 4], "little") for i in (0, 4)
            )
            position += 8
            if position + size > length:
                raise self.error("is damaged: a GLB chunk is longer than the file")
            if kind == _JSON_CHUNK and not text:
                text = content[position : position + size]
            elif kind == _BINARY_CHUNK and self._binary is None:
                self._binary = content[position : position + size]
            position += size
        return text.rstrip(b"\0")

    def _check_version(self) -> None:
        asset = self.child(self.root, "asset")
        version = asset.get("version", "2.0")
        if not isinstance(version, str) or not version.startswith("2"):
            raise self.error(f"glTF version {shown(str(version).encode())} is not supported")
        for name in self.entries(self.root, "extensionsRequired"):
            if not isinstance(name, str) or not can_read(name):
                raise self.error(
                    f"needs the extension {shown(str(name).encode())}, which is not supported"
                )

    def extensions_used(self) -> list[str]:
        """The names of the file's extensions."""
        return [name for name in self.entries(self.root, "extensionsUsed") if isinstance(name, str)]

    def spend_numbers(self, count: int) -> None:
        """Count numbers of morph targets and skins; FileFormatError if there are too many."""
        self._number_count += count
        if self._number_count > MAX_DEFORMATION_NUMBERS:
            raise self.error(
                f"its morph targets and skins have more than {MAX_DEFORMATION_NUMBERS:,} numbers"
            )

    # Checked access.

    def child(self, parent: Node, key: str) -> Node:
        """Get an object; empty if absent."""
        value = parent.get(key, {})
        if not isinstance(value, dict):
            raise self.error(f"is damaged: {key} is not an object")
        return value

    def extension(self, parent: Node, name: str) -> Node | None:
        """Get an extension's object; None if absent."""
        extensions = self.child(parent, "extensions")
        return self.child(extensions, name) if name in extensions else None

    def entries(self, parent: Node, key: str) -> list[Any]:
        """Get a list; empty if absent."""
        value = parent.get(key, [])
        if not isinstance(value, list):
            raise self.error(f"is damaged: {key} is not a list")
        return value

    def entry(self, key: str, index: int) -> Node:
        """Get one object of a list of the document, such as ``meshes``."""
        items = self.entries(self.root, key)
        if not 0 <= index < len(items):
            raise self.error(f"is damaged: {key} has no entry {index}")
        if not isinstance(items[index], dict):
            raise self.error(f"is damaged: entry {index} of {key} is not an object")
        return items[index]

    def name(self, entry: Node) -> str:
        """Get the name of an object; empty if absent or not text."""
        name = entry.get("name")
        return name.strip() if isinstance(name, str) else ""

    def integer(self, parent: Node, key: str, default: int | None = None) -> int:
        """Get an integer >= 0; required without a default."""
        value = parent.get(key, default)
        if isinstance(value, float) and value.is_integer():
            value = int(value)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**53:
            raise self.error(f"is damaged: {key} is not an integer >= 0")
        return value

    def index(self, parent: Node, key: str) -> int | None:
        """Get an index; None if absent."""
        return self.integer(parent, key) if key in parent else None

    def number(self, parent: Node, key: str, default: float) -> float:
        """Get a finite number."""
        return self._finite(parent.get(key, default), key)

    def numbers(self, parent: Node, key: str, default: tuple[float, ...]) -> tuple[float, ...]:
        """Get as many finite numbers as the default has."""
        values = parent.get(key, default)
        if not isinstance(values, (list, tuple)) or len(values) != len(default):
            raise self.error(f"is damaged: {key} is not a list of {len(default)} numbers")
        return tuple(self._finite(value, key) for value in values)

    def number_list(self, parent: Node, key: str) -> tuple[float, ...] | None:
        """Get any number of finite numbers; None if absent."""
        if key not in parent:
            return None
        return tuple(self._finite(value, key) for value in self.entries(parent, key))

    def index_list(self, parent: Node, key: str) -> list[int]:
        """Get a list of indices; empty if absent."""
        return [self.integer({key: value}, key) for value in self.entries(parent, key)]

    def _finite(self, value: Any, key: str) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self.error(f"is damaged: {key} is not a number")
        try:
            result = float(value)
        except OverflowError:
            result = math.inf
        if not math.isfinite(result):
            raise self.error(f"is damaged: {key} is not a finite number")
        return result

    # Buffers.

    def buffer(self, index: int) -> bytes:
        """Read a buffer: the binary chunk, a data URI, or a file next to the model."""
        if index not in self._buffers:
            entry = self.entry("buffers", index)
            declared = self.integer(entry, "byteLength")
            content = self._buffer_content(index, entry)
            if declared > len(content):
                raise self.error(
                    f"is truncated: buffer {index} declares {declared:,} bytes "
                    f"and has {len(content):,}"
                )
            self._buffers[index] = content
        return self._buffers[index]

    def _buffer_content(self, index: int, entry: Node) -> bytes:
        if "uri" not in entry:
            if index == 0 and self._binary is not None:
                return self._binary
            raise self.error(f"is damaged: buffer {index} has no uri")
        uri = self.uri(entry)
        if uri.startswith("data:"):
            return self.decoded(uri)
        found = self.sibling(uri)
        if found is None:
            raise self.error(f"its buffer file {shown(uri.encode())} was not found next to it")
        return read_model_bytes(found)

    def uri(self, entry: Node) -> str:
        """Get the uri of a buffer or image."""
        uri = entry.get("uri")
        if not isinstance(uri, str):
            raise self.error("is damaged: a uri is not text")
        return uri

    def sibling(self, uri: str) -> Path | None:
        """Find the file of a relative uri, which may lack percent-encoding."""
        return find_sibling(self.path, unquote(uri)) or find_sibling(self.path, uri)

    def decoded(self, uri: str) -> bytes:
        """Decode a data URI."""
        head, comma, payload = uri.partition(",")
        try:
            if not comma:
                raise ValueError("no comma")
            if head.endswith(";base64"):
                return base64.b64decode(payload)
            return unquote_to_bytes(payload)
        except (ValueError, binascii.Error):
            raise self.error("is damaged: a data URI cannot be decoded") from None

    def _is_placeholder(self, index: int) -> bool:
        """Whether a buffer holds nothing, and its views are compressed."""
        entry = self.entry("buffers", index)
        return "uri" not in entry and any(
            (self.extension(entry, name) or {}).get("fallback") is True for name in COMPRESSED
        )

    def view(self, index: int) -> tuple[memoryview, int]:
        """Get the bytes of a buffer view, and its stride (0: packed)."""
        view = self.entry("bufferViews", index)
        stride = self.integer(view, "byteStride", 0)
        if not self._is_placeholder(self.integer(view, "buffer")):
            return self._part(view, f"buffer view {index}"), stride
        packed = next(filter(None, (self.extension(view, name) for name in COMPRESSED)), None)
        if packed is None:
            raise self.error(f"is damaged: buffer view {index} has no data")
        part = self._part(packed, f"compressed buffer view {index}")
        length = self.integer(view, "byteLength")
        self._decoded_bytes += length
        if self._decoded_bytes > MAX_DECODED_BYTES:
            raise self.error(f"its compressed buffer views have over {MAX_DECODED_BYTES:,} bytes")
        return memoryview(decoded_view(self, packed, part, length)), stride

    def _part(self, place: Node, label: str) -> memoryview:
        """The bytes of a buffer from ``byteOffset``, ``byteLength`` of them."""
        buffer = self.buffer(self.integer(place, "buffer"))
        start = self.integer(place, "byteOffset", 0)
        length = self.integer(place, "byteLength")
        if start + length > len(buffer):
            raise self.error(f"is damaged: {label} exceeds its buffer")
        return memoryview(buffer)[start : start + length]
