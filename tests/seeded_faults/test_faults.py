"""The seeded faults: each still applies to the sources, and the script reports what catches it.

`.ci/nightly` runs the tests that catch them; here nothing is traced.
"""

from __future__ import annotations

import ast
import subprocess
import time
from pathlib import Path

import pytest

from seeded_faults import run
from seeded_faults.run import CAUGHT, NOT_RUN, ROOT, SOURCES, SURVIVED, read_faults

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
    fault = ENTRIES[0].__class__("name", "what", "core/x.py", "a < b", "a <= b", ("tests",))
    with pytest.raises(ValueError, match="not once"):
        fault.seeded(text)


PROJECT = {
    "pyproject.toml": '[tool.pytest.ini_options]\ntestpaths = ["tests"]\n',
    "src/raystream/__init__.py": "",
    "src/raystream/core/__init__.py": "",
    "src/raystream/core/sums.py": "def add(a, b):\n    return a + b\n\n\nSIGN, UNUSED = 1, 1\n",
    "tests/core/test_sums.py": """
from raystream.core.sums import add

def test_sums():
    assert add(1, 2) == 3
""",
    "tests/test_all.py": """
import subprocess, sys, time
import pytest
from raystream.core.sums import SIGN

@pytest.mark.parametrize("what", ["a - b"])
def test_sign(what):
    assert SIGN == 1

def test_wait():
    if SIGN == 2:
        subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"],
                         start_new_session=True)
        time.sleep(600)
""",
    "faults.toml": """
[[faults]]
name = "by the room"
what = ""
file = "core/sums.py"
old = "a + b"
new = "a - b"
tests = ["tests/core"]

[[faults]]
name = "by the rest"
what = ""
file = "core/sums.py"
old = "SIGN, UNUSED = 1, 1"
new = "SIGN, UNUSED = 0, 1"
tests = ["tests/core"]

[[faults]]
name = "by none"
what = ""
file = "core/sums.py"
old = "SIGN, UNUSED = 1, 1"
new = "SIGN, UNUSED = 1, 0"
tests = ["tests/core"]

[[faults]]
name = "elsewhere"
what = ""
file = "core/sums.py"
old = "a + b"
new = "a - b"
tests = ["tests/core"]
needs = ["no_such_module"]
""",
}


@pytest.fixture
def project(tmp_path):
    """A small project with its own sources, tests and faults."""
    for name, text in PROJECT.items():
        path = tmp_path / "project" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path / "project"


@pytest.mark.exhaustive
def test_the_table_says_which_test_catches_a_fault(project, tmp_path, capsys, monkeypatch):
    monkeypatch.delenv("PYTEST_ADDOPTS", raising=False)
    before = {path: path.read_bytes() for path in project.rglob("*") if path.is_file()}
    record = tmp_path / "results.json"
    options = [f"--json={record}", "--workers=1"]
    assert run.main(options, project, project / "faults.toml") == 1
    assert {path: path.read_bytes() for path in project.rglob("*") if path.is_file()} == before
    lines = capsys.readouterr().out.split("\n\n")[-1].splitlines()
    words = [line.split() for line in lines]
    assert words[0][3] == words[1][3] == CAUGHT
    assert words[0][-1] == "tests/core/test_sums.py::test_sums"
    assert lines[1].endswith("tests/test_all.py::test_sign[a - b]")
    assert SURVIVED in lines[2]
    assert NOT_RUN in lines[3]
    assert "no_such_module" in lines[3]
    # Those that were caught are not run again.
    monkeypatch.setattr(run, "try_fault", lambda *_: (CAUGHT, "by nothing"))
    assert run.main([*options, "--resume"], project, project / "faults.toml") == 0
    assert capsys.readouterr().out.count("by nothing") == 4


@pytest.mark.exhaustive
def test_a_test_that_fails_anyway_catches_nothing(project, capsys, monkeypatch):
    monkeypatch.delenv("PYTEST_ADDOPTS", raising=False)
    path = project / "tests" / "core" / "test_sums.py"
    path.write_text(path.read_text() + "\ndef test_never():\n    assert False\n")
    names = ["by none"]
    assert run.main([*names, "--workers=1"], project, project / "faults.toml") == 1
    printed = capsys.readouterr().out
    assert "fails without any fault: tests/core/test_sums.py::test_never\n" in printed
    assert SURVIVED in printed.splitlines()[-2]


@pytest.mark.exhaustive
@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="looks at /proc")
def test_nothing_is_left_of_a_run_that_hangs(project, tmp_path, monkeypatch):
    monkeypatch.delenv("PYTEST_ADDOPTS", raising=False)
    path = project / SOURCES / "core" / "sums.py"
    path.write_text(path.read_text().replace("SIGN, UNUSED = 1", "SIGN, UNUSED = 2"))
    runner = run.Runner(project, tmp_path, 1, 6.0)
    started = time.monotonic()
    with pytest.raises(TimeoutError):
        runner.run(["tests/test_all.py::test_wait"], {})
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
