"""``benchmarks/code_size.py`` on a small made-up tree: what it counts, and what not."""

from __future__ import annotations

import importlib.util
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "benchmarks" / "code_size.py"
if not SCRIPT.is_file():
    pytest.skip("the scripts are not in an installed package", allow_module_level=True)

spec = importlib.util.spec_from_file_location("code_size", SCRIPT)
code_size = importlib.util.module_from_spec(spec)
spec.loader.exec_module(code_size)

FILES = {
    "room/walk.py": """
def make(leaf):
    def walk(tree):
        return leaf(tree)
    return walk

def _keep(hit):
    return offer(hit)

keep_row = copied(_keep)

class Backend:
    def run(self, a, b, c, d, e, f, g, h, i, *, j): ...
""",
    "room/tree.wgsl": "fn search(ray: Ray) {\n}\n",
    "machines/run.py": "def run(self, a, b, c, d, e, f, g, h, i): ...\n",
    "rendering/film.py": "async def film(a, b, c, d, e, f, g, h, i, /, j): ...\n",
}


@pytest.mark.parametrize(
    ("entry", "expected"),
    [
        ("room/walk.py make.walk", True),
        ("room/walk.py walk.make", False),
        ("room/walk.py make.keep", False),
        ("room/walk.py Backend", True),
        ("room/walk.py Backend.run", True),
        ("room/walk.py keep_row", True),
        ("room/gone.py make", False),
        ("room/tree.wgsl search", True),
        ("room/tree.wgsl sear", False),
        ({"at": "room/walk.py _keep", "without": "offer"}, False),
        ({"at": "room/walk.py _keep", "without": "keep"}, True),
    ],
)
def test_entries_are_looked_up_in_the_syntax_tree(entry, expected):
    assert code_size.is_there(FILES, code_size.modules(FILES), entry) is expected


def test_moved_files_are_found_at_both_places():
    moved, trees = {"earlier/walk.py": "room/walk.py"}, code_size.modules(FILES)
    assert code_size.is_there(FILES, trees, "earlier/walk.py make.walk", moved)
    assert code_size.is_there(FILES, trees, "room/walk.py make.walk", moved)
    assert not code_size.is_there(FILES, trees, "earlier/gone.py make.walk", moved)


def test_entries_are_counted_by_how_they_were_found():
    kinds = {"walks": {"listed": ["room/walk.py make", "room/walk.py gone"], "found": [],
                       "apart": ["room/tree.wgsl search"]}}  # fmt: skip
    [(_, there)] = code_size.repeated(FILES, code_size.modules(FILES), kinds)
    assert there == {"listed": ["room/walk.py make"], "found": [], "apart": kinds["walks"]["apart"]}


def test_wide_functions_are_counted_without_self():
    found = {name: count for _, name, count in code_size.long_signatures(code_size.modules(FILES))}
    assert found == {"room/walk.py:13 run": 10, "rendering/film.py:1 film": 10}


@pytest.mark.parametrize(
    ("text", "at_runtime", "in_all"),
    [
        ("import raystream.room.a", True, True),
        ("from raystream.room.a import name", True, True),
        ("from raystream.room import a", True, True),
        ("from . import a", True, True),
        ("from .a import name", True, True),
        ("def f():\n    from raystream.room.a import name", True, True),
        ("if TYPE_CHECKING:\n    from raystream.room.a import name", False, True),
        ("if not TYPE_CHECKING:\n    import raystream.room.a", True, True),
        ("if TYPE_CHECKING:\n    pass\nelse:\n    import raystream.room.a", True, True),
        ("import raystream.room.c", False, False),
        ("from raystream.room import c", False, False),
        ("import numpy", False, False),
    ],
)
def test_circles_are_found(text, at_runtime, in_all):
    files = {
        "room/__init__.py": "from raystream.room.a import name\n",
        "room/a.py": "from raystream.room.c import d\nfrom raystream.room import b\n",
        "room/b.py": text,
        "room/c.py": "d = 1\n",
    }
    trees = code_size.modules(files)
    circle = [["room/a.py", "room/b.py"]]
    for only_running, expected in ((True, at_runtime), (False, in_all)):
        found = code_size.circles(code_size.imports(trees, only_running))
        assert found == (circle if expected else [])


def test_circles_that_share_a_file_are_one():
    graph = {"a": {"b", "c"}, "b": {"a"}, "c": {"a", "d"}, "d": set(), "e": {"f"}, "f": {"e", "a"}}
    assert code_size.circles(graph) == [["a", "b", "c"], ["e", "f"]]


def test_a_commit_is_read_as_it_was(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(code_size, "ROOT", tmp_path)
    path = tmp_path / "src/raystream/room/walk.py"
    path.parent.mkdir(parents=True)
    path.write_text(FILES["room/walk.py"], encoding="utf-8")
    author = ["-c", "user.name=a", "-c", "user.email=b"]
    for command in (["init", "-q"], ["add", "."], [*author, "commit", "-qm", "one"]):
        subprocess.run(["git", *command], cwd=tmp_path, check=True)
    path.write_text("", encoding="utf-8")
    assert code_size.files_at("HEAD") == {"room/walk.py": FILES["room/walk.py"]}
    code_size.main(["--commit", "HEAD"])
    shown = capsys.readouterr().out
    assert "1 functions with more than 9 parameters" in shown
    assert "0 circles of files" in shown


def test_few_places_ask_for_the_class_of_a_geometry() -> None:
    found = list(code_size.store_tests(code_size.modules(code_size.files_now())))
    assert len(found) <= code_size.MOST_STORE_TESTS, found
    made_up = {"a.py": code_size.ast.parse("isinstance(a, Primitives | int) or isinstance(b, int)")}
    assert list(code_size.store_tests(made_up)) == ["a.py:1"]
