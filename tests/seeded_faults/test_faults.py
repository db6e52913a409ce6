"""The seeded faults: each applies to the sources and has a row in the matrix, which is right.

`.ci/nightly` runs the tests that catch them; here nothing is traced.
"""

from __future__ import annotations

import ast
import os
import subprocess
import time
from dataclasses import replace
from pathlib import Path

import pytest

from seeded_faults import run
from seeded_faults.attempts import NOT_RUN, NOTHING, Row
from seeded_faults.by_file import CI, EVERYDAY
from seeded_faults.faults import AGREEMENT, NOT_TRACED, ROOT, SOURCES, Fault, read_faults
from seeded_faults.matrix import cover, is_current, read_matrix, refreshed, write_matrix
from seeded_faults.runner import STUCK, Runner

ENTRIES = read_faults()


@pytest.mark.parametrize("fault", ENTRIES, ids=lambda fault: fault.name)
def test_every_fault_has_its_place(fault):
    path = ROOT / fault.path
    text = path.read_text(encoding="utf-8")
    seeded = fault.seeded(text)
    if path.suffix == ".py":
        compile(seeded, fault.path, "exec")
        assert ast.dump(ast.parse(seeded)) != ast.dump(ast.parse(text))
    assert seeded != text
    assert fault.tests
    for test in fault.tests:
        assert (ROOT / test.partition("::")[0]).exists(), test


def test_every_room_has_faults():
    modules = {path.stem for path in (ROOT / SOURCES).glob("[a-z]*.py")}
    packages = {path.parent.name for path in (ROOT / SOURCES).glob("*/__init__.py")}
    assert {fault.room for fault in ENTRIES} == modules | packages | {"lab"}
    assert len({fault.name for fault in ENTRIES}) == len(ENTRIES) >= 30


@pytest.mark.parametrize("text", ["a = b", "a < b, then a < b"])
def test_a_text_that_is_not_there_once_is_said(text):
    fault = Fault("name", "what", "core/x.py", "a < b", "a <= b", ("tests",))
    with pytest.raises(ValueError, match="not once"):
        fault.seeded(text)


def test_every_fault_has_a_row_in_the_matrix():
    rows = read_matrix()
    assert set(rows) == {fault.name for fault in ENTRIES}
    for name, row in rows.items():
        assert (row.verdict in (EVERYDAY, CI)) == bool(row.by), name
        assert not set(row.by) & set(row.clean), name


def test_files_of_agreement_and_rooms_that_they_do_not_trace_exist():
    assert all((ROOT / file).is_file() for file in AGREEMENT)
    for path in NOT_TRACED:
        assert any(fault.file.startswith(path) for fault in ENTRIES), path


def test_files_of_the_module_come_first():
    fault = Fault("name", "", "structures/grid.py", "a", "b", ("tests/structures", "tests/core"))
    files = fault.room_files(ROOT)
    assert all("grid" in file for file in files[:3])
    assert files == list(dict.fromkeys(files))
    assert not set(files) & set(fault.agreement_files(ROOT))
    assert "tests/test_agreement.py" in fault.agreement_files(ROOT)
    assert not Fault("name", "", "cli/x.py", "a", "b", ("tests/cli",)).agreement_files(ROOT)


# ---- Rows.

CORE = Fault("one", "", "core/sums.py", "a + b", "a - b", ("tests/core",))


def row_of(fault: Fault, root: Path, verdict: str = EVERYDAY, **more) -> Row:
    return Row(fault.digest(root), verdict, {"tests/a.py": "tests/a.py::a"}, **more)


def test_a_row_is_stale_once_code_has_changed(tmp_path):
    path = tmp_path / CORE.path
    path.parent.mkdir(parents=True)
    path.write_text('"""Sums."""\n\ndef add(a, b):\n    return a + b\n')
    row = row_of(CORE, tmp_path)
    assert is_current(row, CORE, tmp_path, stops_early=False)
    assert is_current(row, replace(CORE, what="other words"), tmp_path, stops_early=False)
    assert not is_current(row, replace(CORE, new="a * b"), tmp_path, stops_early=False)
    path.write_text('def add(a, b):\n    """Add."""\n    return a + b  # a sum\n')
    assert is_current(row, CORE, tmp_path, stops_early=False)
    path.write_text("def add(a, b, c=None):\n    return a + b\n")
    assert not is_current(row, CORE, tmp_path, stops_early=False)


def test_what_is_known_of_a_fault_decides_whether_it_is_tried(tmp_path):
    path = tmp_path / CORE.path
    path.parent.mkdir(parents=True)
    path.write_text("a + b")
    part = row_of(CORE, tmp_path, is_complete=False)
    assert is_current(part, CORE, tmp_path, stops_early=True)
    assert not is_current(part, CORE, tmp_path, stops_early=False)
    assert not is_current(None, CORE, tmp_path, stops_early=True)
    needy = replace(CORE, needs=("no_such_module",))
    untried = Row(needy.digest(tmp_path), NOT_RUN)
    assert is_current(untried, needy, tmp_path, stops_early=True)
    assert is_current(row_of(needy, tmp_path), needy, tmp_path, stops_early=True)


def test_a_row_loses_tests_that_have_left_their_tier():
    row = Row("", EVERYDAY, {"a": "a::t", "b": "b::t"})
    assert refreshed(row, CORE, {"a::t": EVERYDAY, "b::t": EVERYDAY}) == row
    left = refreshed(row, CORE, {"a::t": CI, "b::t": EVERYDAY})
    assert (dict(left.by), left.is_complete) == ({"b": "b::t"}, False)
    assert refreshed(row, CORE, {"a::t": CI}) is None
    assert refreshed(replace(row, verdict=CI), CORE, {"a::t": EVERYDAY, "b::t": CI}) is None
    nothing = Row("", NOTHING)
    assert refreshed(nothing, CORE, {}) == nothing


def test_the_cover_is_greedy():
    faults = [replace(CORE, name=name) for name in "abcd"] + [replace(CORE, name="e", needs=("x",))]
    files = {"a": "xy", "b": "xz", "c": "yz", "d": "z", "e": "w"}
    rows = {name: Row("", EVERYDAY, {file: file for file in by}) for name, by in files.items()}
    rows["d"] = replace(rows["d"], verdict=CI)
    assert cover(rows, faults) == [("x", ["a", "b"]), ("y", ["c"])]


def test_the_file_has_rows_by_name_and_no_defaults(tmp_path):
    path = tmp_path / "matrix.json"
    rows = {"b": Row("1", NOTHING), "a": Row("2", EVERYDAY, {"x": "y"}, ["z"], False, "why")}
    write_matrix(path, rows)
    assert path.read_text().index('"a"') < path.read_text().index('"b"')
    assert "is_complete" not in path.read_text().partition('"b"')[2]
    assert read_matrix(path)["a"] == rows["a"]
    assert read_matrix(path)["b"].verdict == NOTHING
    assert os.listdir(tmp_path) == ["matrix.json"]


# ---- A small project.

PROJECT = {
    "pyproject.toml": """
[tool.pytest.ini_options]
testpaths = ["tests"]
addopts = ["-m not ci"]
markers = ["ci: .", "exhaustive: .", "documentation: ."]
""",
    "src/raystream/__init__.py": "",
    "src/raystream/core/__init__.py": "",
    "src/raystream/core/sums.py": """
def add(a, b):
    return a + b

SIGN, UNUSED, DEEP, CRASHES, WAITS = 1, 1, 1, 0, 0
""",
    "tests/core/test_sums.py": """
import os, subprocess, sys, time
import pytest
from raystream.core import sums

@pytest.mark.ci
def test_deep():
    assert sums.DEEP == 1

@pytest.mark.exhaustive
def test_unused():
    assert sums.UNUSED == 1

def test_sums():
    assert sums.add(1, 2) == 3

@pytest.mark.parametrize("other", [3, 4])
def test_more_sums(other):
    assert sums.add(other, 2) == other + 2

def test_crash():
    if sums.CRASHES:
        os.abort()

def test_wait():
    if sums.WAITS:
        subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"],
                         start_new_session=True)
        time.sleep(600)
""",
    "tests/core/test_zero.py": """
from raystream.core.sums import add

def test_zero():
    assert add(2, 0) == 2
""",
    "tests/test_agreement.py": """
from raystream.core.sums import add

def test_agreement():
    assert add(2, 3) == 5
""",
    "tests/test_all.py": """
import pytest
from raystream.core.sums import SIGN

@pytest.mark.parametrize("what", ["a - b"])
def test_sign(what):
    assert SIGN == 1
""",
}
CHANGES = {
    "by its room": ("a + b", "a - b"),
    "by the rest": ("= 1, 1, 1, 0, 0", "= 0, 1, 1, 0, 0"),
    "by none": ("= 1, 1, 1, 0, 0", "= 1, 0, 1, 0, 0"),
    "by ci": ("= 1, 1, 1, 0, 0", "= 1, 1, 0, 0, 0"),
    "by a crash": ("= 1, 1, 1, 0, 0", "= 1, 1, 1, 1, 0"),
    "by waiting": ("= 1, 1, 1, 0, 0", "= 1, 1, 1, 0, 1"),
    "elsewhere": ("a + b", "a * b"),
}
MORE = {"by waiting": "hangs = true\n", "elsewhere": 'needs = ["no_such_module"]\n'}
SUMS, ZERO, AGREES = "tests/core/test_sums.py", "tests/core/test_zero.py", "tests/test_agreement.py"


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A small project with its own sources, tests and faults."""
    monkeypatch.delenv("PYTEST_ADDOPTS", raising=False)
    entries = (
        f'[[faults]]\nname = "{name}"\nwhat = ""\nfile = "core/sums.py"\ntests = ["tests/core"]\n'
        f'old = "{old}"\nnew = "{new}"\n{MORE.get(name, "")}'
        for name, (old, new) in CHANGES.items()
    )
    for name, text in {**PROJECT, "faults.toml": "\n".join(entries)}.items():
        path = tmp_path / "project" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path / "project"


@pytest.fixture
def seed(project, tmp_path):
    """Run the script on it; returns the exit status and the rows of its matrix."""

    def run_it(*arguments):
        matrix = tmp_path / "matrix.json"
        options = [*arguments, "--test-limit=15"]
        status = run.main(options, project, project / "faults.toml", matrix)
        return status, read_matrix(matrix)

    return run_it


@pytest.mark.exhaustive
def test_the_matrix_says_which_files_catch_a_fault(project, seed, capsys, monkeypatch):
    before = {path: path.read_bytes() for path in project.rglob("*") if path.is_file()}
    status, rows = seed("--matrix")
    assert status == 1
    assert {path: path.read_bytes() for path in project.rglob("*") if path.is_file()} == before
    assert set(rows) == set(CHANGES)
    room = rows["by its room"]
    assert (room.verdict, room.is_complete) == (EVERYDAY, True)
    assert room.by == {SUMS: f"{SUMS}::test_sums", AGREES: f"{AGREES}::test_agreement"}
    assert room.clean == [ZERO]
    rest = rows["by the rest"]
    assert (rest.verdict, rest.by) == (
        EVERYDAY,
        {"tests/test_all.py": "tests/test_all.py::test_sign[a - b]"},
    )
    assert rest.clean == [SUMS, ZERO, AGREES]
    assert (rows["by none"].verdict, rows["by none"].by) == (NOTHING, {})
    assert (rows["by ci"].verdict, rows["by ci"].by) == (CI, {SUMS: f"{SUMS}::test_deep"})
    crash = rows["by a crash"]
    assert (crash.verdict, crash.by) == (EVERYDAY, {SUMS: f"{SUMS}::test_crash"})
    assert crash.clean == [ZERO, AGREES]
    waiting = rows["by waiting"]
    assert (waiting.verdict, waiting.by) == (EVERYDAY, {SUMS: f"{SUMS}::test_wait"})
    assert rows["elsewhere"].verdict == NOT_RUN
    assert "no_such_module" in rows["elsewhere"].reason
    printed = capsys.readouterr().out
    assert "7 faults: 4 caught by everyday tests, 1 only by those of ci, 1 by nothing" in printed
    assert "6 need no extra and are not in the lab: 4 caught by everyday" in printed
    assert "not caught: by none" in printed
    # A second run finds nothing to do.
    monkeypatch.setattr(run, "try_fault", lambda *_, **__: pytest.fail("tried again"))
    assert seed("--matrix") == (1, rows)


@pytest.mark.exhaustive
def test_a_run_resumes_and_leaves_out_rows_of_faults_that_are_gone(project, seed, monkeypatch):
    tried = []
    try_fault = run.try_fault

    def interrupted(fault, *arguments, **options):
        if tried:
            raise KeyboardInterrupt
        tried.append(fault.name)
        return try_fault(fault, *arguments, **options)

    monkeypatch.setattr(run, "try_fault", interrupted)
    options = ("--matrix", "--until-caught", "--workers=1", "by its room", "by the rest")
    status, rows = seed(*options)
    assert (status, list(rows)) == (130, ["by its room"])
    assert len(rows["by its room"].by) == 1
    monkeypatch.setattr(run, "try_fault", try_fault)
    status, rows = seed(*options)
    assert (status, list(rows)) == (0, ["by its room", "by the rest"])
    path = project / "faults.toml"
    path.write_text(path.read_text().replace('"by its room"', '"by another name"'))
    monkeypatch.setattr(run, "try_fault", lambda *_, **__: pytest.fail("tried again"))
    assert seed("--matrix", "--until-caught", "by the rest") == (
        0,
        {"by the rest": rows["by the rest"]},
    )


@pytest.mark.exhaustive
def test_a_fault_is_tried_again_once_its_tests_are_of_ci(project, seed, monkeypatch):
    names = ("by its room", "by the rest")
    _, rows = seed("--matrix", *names)
    for name in (SUMS, "tests/test_all.py"):
        path = project / name
        path.write_text(path.read_text() + "\npytestmark = pytest.mark.ci\n")
    tried = []
    try_fault = run.try_fault

    def noted(fault, *arguments, **options):
        tried.append(fault.name)
        return try_fault(fault, *arguments, **options)

    monkeypatch.setattr(run, "try_fault", noted)
    _, rows = seed("--matrix", "--until-caught", *names)
    assert tried == ["by the rest"]
    assert list(rows["by its room"].by) == [AGREES]
    assert (rows["by the rest"].verdict, list(rows["by the rest"].by)) == (
        CI,
        ["tests/test_all.py"],
    )


@pytest.mark.exhaustive
def test_a_test_that_fails_anyway_catches_nothing(project, seed, capsys):
    path = project / SUMS
    path.write_text(path.read_text() + "\ndef test_never():\n    assert False\n")
    (project / "tests" / "core" / "test_broken.py").write_text("import no_such_module\n")
    status, rows = seed("--matrix", "--workers=1", "by none", "by its room")
    printed = capsys.readouterr().out
    assert status == 1
    assert f"fails without any fault: {SUMS}::test_never\n" in printed
    assert "fails without any fault: tests/core/test_broken.py\n" in printed
    assert rows["by none"].verdict == NOTHING
    assert list(rows["by its room"].by) == [SUMS, AGREES]


@pytest.mark.exhaustive
def test_a_file_that_cannot_be_imported_is_of_its_tests_tier(project, seed):
    for name, mark in (("test_one.py", "@pytest.mark.ci"), ("test_two.py", "")):
        (project / "tests" / name).write_text(
            f"import pytest\nfrom raystream.core.sums import SIGN\nassert SIGN\n"
            f"{mark}\ndef test_nothing():\n    pass\n"
        )
    path = project / "faults.toml"
    entries = path.read_text()
    for name, verdict in (("test_one.py", CI), ("test_two.py", EVERYDAY)):
        file = f"tests/{name}"
        path.write_text(entries.replace('"tests/core"', f'"{file}"'))
        _, rows = seed("--matrix", "by the rest")
        assert (rows["by the rest"].verdict, rows["by the rest"].by) == (verdict, {file: file})
        assert seed("--matrix", "by the rest")[1] == rows


@pytest.mark.exhaustive
def test_without_a_matrix_each_fault_needs_one_catch(seed, capsys):
    names = ("by its room", "by ci", "by none")
    assert seed(*names) == (1, {})
    assert "not caught: by none" in capsys.readouterr().out
    _, rows = seed("--matrix", *names[:2])
    assert seed(*names[:2]) == (0, rows)


@pytest.mark.exhaustive
@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="looks at /proc")
def test_nothing_is_left_of_a_run_that_hangs(project, tmp_path):
    path = project / SOURCES / "core" / "sums.py"
    path.write_text(path.read_text().replace("1, 0, 0", "1, 0, 1"))
    runner = Runner(project, tmp_path / "run", tmp_path / "cache", 60.0, 6.0)
    started = time.monotonic()
    outcome = runner.run([SUMS], {})
    assert (outcome.ended, outcome.running) == (STUCK, f"{SUMS}::test_wait")
    assert time.monotonic() - started < 60.0
    listed = subprocess.run(["ps", "-eo", "args"], capture_output=True, text=True).stdout
    assert "time.sleep(600)" not in listed


def test_faults_are_listed_by_room(capsys):
    assert run.main(["--list", "viewer"]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert len(printed) == sum(fault.room == "viewer" for fault in ENTRIES)
    assert all(line.startswith("viewer: ") for line in printed)
    with pytest.raises(SystemExit, match="no fault and no room 'cellar'"):
        run.main(["cellar"])
