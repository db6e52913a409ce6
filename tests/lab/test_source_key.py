"""The key of the sources that can change counts."""

from __future__ import annotations

from pathlib import Path

import pytest

from extras import need

need("raystream_lab")

import raystream
import raystream_lab
from raystream_lab import source_key as keys
from raystream_lab.source_key import counting_files, key_of


def test_the_key_covers_what_counts() -> None:
    files = counting_files()
    for name in (
        "raystream/structures/kdtree/build.py",
        "raystream/kernels/slab.py",
        "raystream/machines/schedulers.py",
        "raystream/rendering/path.py",
        "raystream/scene/procedural/cubes.py",
        "raystream_lab/published.json",
        "raystream_lab/purcell/image_costs.py",
        "raystream_lab/results.py",
        "raystream_lab/walks/replaying.py",
    ):
        assert name in files
    assert not [
        name
        for name in files
        if any(f"/{part}" in name for part in ("cuda/", "graphics/", "cli/", "viewer/", "report/"))
        or "on_graphics" in name
    ]
    assert list(files) == sorted(files)


def test_listed_parts_exist() -> None:
    for package, parts in (
        (raystream, (*keys._ENGINE, *keys._ENGINE_OUT)),
        (raystream_lab, keys._LAB_OUT),
    ):
        assert package.__file__ is not None
        home = Path(package.__file__).parent
        assert [one for one in parts if not (home / one).exists()] == []


@pytest.mark.parametrize(
    ("code", "is_same"),
    [
        ('"""Other words."""\nTWO = 2\n\n\ndef f(a, b):\n    "Add."\n    return a + TWO * b', True),
        ("# no words\nTWO = (2)\ndef f(a,\n      b):\n    return a + TWO * b  # sum", True),
        ("TWO = 3\ndef f(a, b):\n    return a + TWO * b", False),
        ("TWO = 2\ndef f(a, b):\n    return a + b * TWO", False),
        ("TWO = 2.0\ndef f(a, b):\n    return a + TWO * b", False),
        ("TWO = 2\ndef f(a, b, c=None):\n    return a + TWO * b", False),
        ('TWO = 2\ndef f(a, b):\n    g("Add.")\n    return a + TWO * b', False),
    ],
)
def test_only_code_changes_the_key(tmp_path: Path, code: str, is_same: bool) -> None:
    first, second = tmp_path / "a.py", tmp_path / "b.py"
    first.write_text('"""Words."""\nTWO = 2\ndef f(a, b):\n    return a + TWO * b\n')
    second.write_text(code)
    assert (key_of({"x.py": first}) == key_of({"x.py": second})) == is_same
    assert key_of({"x.py": first}) != key_of({"y.py": first})


def test_data_counts_byte_by_byte(tmp_path: Path) -> None:
    path = tmp_path / "published.json"
    path.write_text("{}")
    before = key_of({"published.json": path})
    path.write_text("{ }")
    assert key_of({"published.json": path}) != before
