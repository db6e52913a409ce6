"""What pages hold comes out as it went in."""

from __future__ import annotations

import base64
import json
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from raystream.web.pack import pack


def unpacked(text: str) -> tuple[dict, dict[str, np.ndarray]]:
    """As page/pack.js."""
    whole = zlib.decompress(base64.b64decode(text), -15)
    crc, content = int.from_bytes(whole[:4], "little"), whole[4:]
    assert zlib.crc32(content) == crc
    length = int.from_bytes(content[:4], "little")
    manifest, rest = json.loads(content[4 : 4 + length]), content[4 + length :]
    found = {}
    for name, entry in manifest["arrays"].items():
        count = entry["length"]
        planes = np.frombuffer(rest[: 4 * count], np.uint8).reshape(4, count)
        bits = np.ascontiguousarray(planes.T).view(np.uint32).reshape(count)
        if entry["type"] != "f":
            steps = (bits >> 1).view(np.int32) ^ -(bits & 1).view(np.int32)
            bits = np.cumsum(steps.astype(np.int64)).astype(np.uint32)
        found[name] = bits.view({"f": np.float32, "i": np.int32, "u": np.uint32}[entry["type"]])
        rest = rest[4 * count :]
    assert not rest
    return manifest, found


@given(
    floats=arrays.arrays(np.float32, st.integers(0, 40)),
    integers=arrays.arrays(np.int32, st.tuples(st.integers(0, 9), st.just(3))),
    words=arrays.arrays(np.uint32, st.integers(0, 40)),
)
def test_arrays_come_out_bit_for_bit(floats, integers, words):
    given_ = {"floats": floats, "integers": integers, "words": words}
    manifest, found = unpacked(pack({"name": "a scene"}, given_))
    assert manifest["name"] == "a scene"
    for name, array in given_.items():
        assert found[name].dtype == array.dtype
        assert found[name].tobytes() == array.tobytes()


def test_neighbours_take_less_room():
    ids = np.repeat(np.arange(20_000, dtype=np.int32), 3)
    assert len(pack({}, {"ids": ids})) < ids.nbytes / 20


def test_numbers_of_other_sizes_are_refused():
    with pytest.raises(TypeError, match="ids: expected numbers of four bytes, got int64"):
        pack({}, {"ids": np.zeros(3, np.int64)})
