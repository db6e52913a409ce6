"""The key of the sources that can change counts, and the stored report's."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from extras import need

need("raystream_lab")

import raystream
import raystream_lab
from raystream_lab import source_key as keys
from raystream_lab.source_key import counting_files, key_of, source_key

STORED = Path(__file__).resolve().parents[2] / "docs" / "lab" / "cpu" / "about.json"


def check_stored(path: Path) -> None:
    """Fail if the report is of other sources; skip if there is none."""
    if not path.exists():
        pytest.skip(f"no stored report: {path} is missing")
    about = json.loads(path.read_text(encoding="utf-8"))
    if not about.get("source"):
        pytest.skip(f"the stored report has no key of its sources: {path}")
    if about["source"] != source_key():
        pytest.fail(
            f"{path} is of other sources ({about['source']}, now {source_key()}): run "
            f"`{about.get('command', 'raystream lab all')}` and store its report"
        )


def test_the_stored_report_is_of_these_sources() -> None:
    check_stored(STORED)


def test_a_stale_report_fails_with_its_command(tmp_path: Path) -> None:
    path = tmp_path / "about.json"
    with pytest.raises(pytest.skip.Exception, match="no stored report"):
        check_stored(path)
    path.write_text("{}")
    with pytest.raises(pytest.skip.Exception, match="no key"):
        check_stored(path)
    path.write_text(json.dumps({"source": "0" * 16, "command": "raystream lab all -o x"}))
    with pytest.raises(pytest.fail.Exception, match="run `raystream lab all -o x`"):
        check_stored(path)
    path.write_text(json.dumps({"source": source_key()}))
    check_stored(path)


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
