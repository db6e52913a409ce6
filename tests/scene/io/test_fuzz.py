"""Damaged files: cut short, with bytes changed, or made up, they end in one clear error."""

from __future__ import annotations

import gzip
import time
import warnings
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from raystream.core.errors import FileFormatError, RaystreamWarning
from raystream.scene.io import formats, instances
from raystream.scene.scene import Scene
from scene.io import tiny

#: No damaged tiny file may take longer; they take a millisecond, on a busy machine now and then
#: seconds.
SECONDS = 20.0


@pytest.fixture(autouse=True)
def _small_budgets(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(instances, "MAX_INSTANCED_TRIANGLES", 100_000)


def outcome(path: Path, content: bytes) -> Scene | str:
    """Read with the bare reader, without the net that `read_model` spreads beneath it."""
    path.write_bytes(content)
    suffix = formats.model_suffix(path)
    module, function = formats._READERS[suffix]
    reader = getattr(import_module(f"raystream.scene.io.{module}"), function)
    begin = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RaystreamWarning)
            scene = reader(path)
            assert isinstance(scene, Scene)
            assert scene.skipped_count <= scene.triangle_count
            return scene
    except FileFormatError as error:
        message = str(error)
        assert "\n" not in message
        assert message.startswith(f"{path.parent}")
        return message
    finally:
        assert time.perf_counter() - begin < SECONDS


def damaged(content: bytes, seed: int, count: int) -> Iterator[bytes]:
    """Change up to four bytes; half of the time into something that means something."""
    random = np.random.default_rng(seed)
    telling = np.frombuffer(b'0123456789-+.e/ \n#{}[],:"\0\xff\x80\x7f', np.uint8)
    for _ in range(count):
        changed = bytearray(content)
        for _ in range(int(random.integers(1, 5))):
            place = int(random.integers(len(changed)))
            if random.random() < 0.5:
                changed[place] = int(random.integers(256))
            else:
                changed[place] = int(random.choice(telling))
        yield bytes(changed)


@pytest.mark.parametrize("name", tiny.ALL)
def test_tiny_models_are_valid(tmp_path: Path, name: str) -> None:
    scene = outcome(tmp_path / name, tiny.ALL[name])
    assert isinstance(scene, Scene)
    assert scene.triangle_count >= 1


@pytest.mark.parametrize("name", tiny.ALL)
def test_cut_short(tmp_path: Path, name: str) -> None:
    content = tiny.ALL[name]
    path = tmp_path / name
    errors = 0
    for end in range(0, len(content), max(1, len(content) // 150)):
        errors += isinstance(outcome(path, content[:end]), str)
    assert errors > 20


@pytest.mark.parametrize("name", tiny.ALL)
def test_changed_bytes(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    results = [outcome(path, content) for content in damaged(tiny.ALL[name], 1, 250)]
    assert any(isinstance(result, str) for result in results)


def test_changed_bytes_of_packed_files(tmp_path: Path) -> None:
    path = tmp_path / "a.obj.gz"
    results = [outcome(path, content) for content in damaged(gzip.compress(tiny.OBJ), 2, 250)]
    assert sum(isinstance(result, str) for result in results) > 100


@pytest.mark.parametrize("suffix", [s for s in formats.SUFFIXES if s != ".nff"])
@settings(
    max_examples=60,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(body=st.binary(max_size=200))
def test_made_up_files(tmp_path: Path, suffix: str, body: bytes) -> None:
    starts = {
        ".ply": b"ply\nformat binary_little_endian 1.0\n",
        ".off": b"OFF\n",
        ".stl": b"solid ",
        ".obj": b"v 0 0 0\nf ",
        ".gltf": b"{",
        ".glb": b"glTF\2\0\0\0",
        ".aff": b"m vertices ",
    }
    outcome(tmp_path / f"a{suffix}", body)
    outcome(tmp_path / f"b{suffix}", starts[suffix] + body)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=2)
    ),
    max_leaves=4,
)


@pytest.mark.ci
@pytest.mark.parametrize("make", [tiny.gltf_document, tiny.moving_gltf])
@settings(
    max_examples=300,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(choice=st.integers(min_value=0), value=JSON)
def test_gltf_with_one_value_replaced(
    tmp_path: Path, make: Callable[[], dict[str, Any]], choice: int, value: object
) -> None:
    document = make()
    places = []
    waiting: list[object] = [document]
    while waiting:
        node = waiting.pop()
        keys = (
            node.keys()
            if isinstance(node, dict)
            else range(len(node))
            if isinstance(node, list)
            else ()
        )
        for key in keys:
            places.append((node, key))
            waiting.append(node[key])  # type: ignore[index]
    node, key = places[choice % len(places)]
    node[key] = value  # type: ignore[index]
    outcome(tmp_path / "a.gltf", tiny.gltf_text(document))
