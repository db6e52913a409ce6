"""``.ci/nightly``: the parts that run, their order, and the record that is kept."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
from datetime import UTC, datetime
from pathlib import Path

import pytest

from ci_script import load

ROOT = Path(__file__).resolve().parents[1]
SCRIPT = ROOT / ".ci" / "nightly"

nightly = load("nightly")
Outcome, Part = nightly.Outcome, nightly.Part


@pytest.fixture
def tree(tmp_path):
    """A folder that git does not know, with a room and its tests."""
    for name in ("src/room/a.py", "src/room/b.py", "tests/room/test_a.py"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(name)
    return tmp_path


ROOM = Part("room", ["src/room"], ["tests/room", "-k", "not slow"])


# ---- Detection of changes.


def test_hashes_are_of_sources_tests_and_names(tree):
    seen = [nightly.digest(tree, ROOM)]
    (tree / "src/room/a.py").write_text("changed")
    seen.append(nightly.digest(tree, ROOM))
    (tree / "tests/room/test_a.py").write_text("changed")
    seen.append(nightly.digest(tree, ROOM))
    (tree / "src/room/b.py").rename(tree / "src/room/c.py")
    seen.append(nightly.digest(tree, ROOM))
    (tree / "src/room/deep").mkdir()
    (tree / "src/room/deep/d.py").write_text("new")
    seen.append(nightly.digest(tree, ROOM))
    seen.append(nightly.digest(tree, Part("room", ["src/room"], ["tests/room"])))
    assert len(set(seen)) == len(seen)


@pytest.mark.parametrize(
    "same",
    [
        'def f(a):\n    """Docstring."""\n    return a + 1\n',
        "def f(a):\n    # A comment.\n    return (\n        a + 1  # another\n    )\n",
        '"""A module."""\ndef f(a): return a+1\n',
    ],
)
@pytest.mark.parametrize("name", ["a.py", "script"])
def test_hashes_of_python_are_of_code_alone(name, same):
    start = "#!/usr/bin/env python3\n"
    code = nightly.code_hash(name, f"{start}def f(a):\n    return a + 1\n".encode())
    assert nightly.code_hash(name, (start + same).encode()) == code
    for other in ("return a + 2", "return None", "return 'a' + 1", "'doc'; 'no doc'; return a + 1"):
        changed = f"{start}def f(a):\n    {other}\n".encode()
        assert nightly.code_hash(name, changed) != code


@pytest.mark.parametrize("name", ["a.wgsl", "a.js", "a.toml", "a.html", "a.json", "broken.py"])
def test_other_files_and_broken_python_count_whole(name):
    one, other = b"let a = 1; // one\n", b"let a = 1; // other\n"
    assert nightly.code_hash(name, one) != nightly.code_hash(name, other)


def test_hashes_are_not_of_other_folders_and_compiled_files(tree):
    before = nightly.digest(tree, ROOM)
    (tree / "src/room/__pycache__").mkdir()
    (tree / "src/room/__pycache__/a.pyc").write_text("compiled")
    (tree / "src/other.py").write_text("other")
    assert nightly.digest(tree, ROOM) == before


def test_a_copy_without_git_has_the_same_hash(tree):
    without = nightly.digest(tree, ROOM)
    (tree / ".gitignore").write_text("*.out\n")
    for command in (["init", "--quiet"], ["add", "src/room/a.py"]):
        subprocess.run(["git", *command], cwd=tree, check=True)
    (tree / "src/room/ignored.out").write_text("built")
    assert nightly.digest(tree, ROOM) == without


def test_paths_that_are_not_there_are_named(tree):
    with pytest.raises(SystemExit, match="'room': src/romo: no such files"):
        nightly.digest(tree, Part("room", ["src/romo"]))


# ---- Selection of parts.


def test_the_quickest_part_is_first_and_unknown_ones_last():
    parts = [Part(name, []) for name in ("unknown", "slow", "quick", "new")]
    record = {"slow": {"seconds": 300}, "quick": {"seconds": 2}}
    order = [part.name for part in nightly.in_order(parts, record)]
    assert order == ["quick", "slow", "unknown", "new"]


def test_none_begins_after_the_time_is_up():
    parts = [Part(str(minutes), []) for minutes in (5, 14, 30, 1)]
    now = [0.0]

    def run(part, seconds):
        left.append(seconds)
        now[0] += 60.0 * int(part.name)
        return Outcome(nightly.PASSED, 1.0)

    left = []
    ran = nightly.run_parts(parts, run, 20.0, lambda: now[0])
    assert list(ran) == ["5", "14", "30"]  # the third begins in time
    assert left == [1200.0, 900.0, 60.0]


@pytest.fixture
def fake(monkeypatch, tmp_path):
    """Parts that end as specified, with a record in a separate folder."""
    parts = dict.fromkeys(("a", "b", "c"), nightly.PASSED)
    ran = []

    def run_part(part, seconds=float("inf")):
        ran.append(part.name)
        return Outcome(parts.get(part.name, nightly.PASSED), 7.4)

    monkeypatch.setattr(nightly, "RECORD", tmp_path / "nightly.json")
    monkeypatch.setattr(nightly, "load_record", lambda: json.loads(record()))
    monkeypatch.setattr(nightly, "load_parts", lambda: [Part(name, ["src"]) for name in parts])
    monkeypatch.setattr(nightly, "digest", lambda root, part: f"hash of {part.name}")
    monkeypatch.setattr(nightly, "head", lambda root: "abc")
    monkeypatch.setattr(nightly, "run_part", run_part)

    def record():
        path = tmp_path / "nightly.json"
        return path.read_text() if path.exists() else "{}"

    return parts, ran, lambda: json.loads(record())


def test_only_green_parts_are_noted(fake, capsys):
    parts, ran, record = fake
    parts["b"], parts["c"] = nightly.FAILED, nightly.NOTHING
    assert nightly.main(["--without-faults"]) == 1
    assert ran == ["a", "b", "c"]
    today = datetime.now(UTC).date().isoformat()
    noted = {"hash": "hash of a", "commit": "abc", "date": today, "seconds": 7}
    assert record() == {"a": noted}
    assert re.search(r"^b +FAILED", capsys.readouterr().out, re.MULTILINE)
    parts["b"] = nightly.PASSED
    assert nightly.main(["b"]) == 0
    assert ran[3:] == ["b"]
    assert list(record()) == ["a", "b"]


def test_a_part_that_breaks_keeps_its_last_green_hash(fake, monkeypatch):
    parts, _, record = fake
    assert nightly.main(["--without-faults"]) == 0
    before = record()
    monkeypatch.setattr(nightly, "digest", lambda root, part: "another hash")
    parts["a"] = nightly.FAILED
    assert nightly.main(["a"]) == 1
    assert record() == before


def test_what_has_changed_runs_and_is_noted(fake, monkeypatch, capsys):
    _, ran, record = fake
    nightly.main(["a", "b"])
    before = record()
    ran.clear()
    monkeypatch.setattr(
        nightly, "digest", lambda _, part: f"hash of {part.name}" + "!" * (part.name == "b")
    )
    assert nightly.main(["--changed", "--no-record"]) == 0
    assert ran == ["b", "c"]
    assert record() == before
    assert re.search(r"^a +unchanged$", capsys.readouterr().out, re.MULTILINE)
    assert nightly.main(["--changed", "--record"]) == 0
    assert [record()[name]["hash"] for name in "abc"] == ["hash of a", "hash of b!", "hash of c"]
    ran.clear()
    assert nightly.main(["--changed"]) == 0
    assert ran == []


def test_parts_without_time_are_listed_and_no_failure(fake, capsys):
    _, ran, _ = fake
    assert nightly.main(["--changed", "--minutes", "0"]) == 0
    assert ran == []
    assert "not run, or not to the end, for want of time: a, b, c" in capsys.readouterr().out


def test_a_part_that_is_ended_early_is_not_noted_and_no_failure(fake, capsys):
    parts, _, record = fake
    parts["b"] = nightly.ENDED
    assert nightly.main(["--changed"]) == 0
    assert sorted(record()) == ["a", "c"]
    shown = capsys.readouterr().out
    assert re.search(r"^b +ended early", shown, re.MULTILINE)
    assert "for want of time: b; run" in shown


def test_seeded_faults_run_last_and_only_with_all_parts(fake, monkeypatch, tmp_path):
    _, ran, record = fake
    monkeypatch.setattr(nightly, "FAULTS", tmp_path / "run.py")
    (tmp_path / "run.py").touch()
    for arguments in (["--changed"], ["--without-faults"], ["a"]):
        nightly.main(arguments)
    assert "seeded faults" not in ran
    nightly.main([])
    assert ran[-1] == "seeded faults"
    assert "seeded faults" not in record()


# ---- What is stale.


@pytest.fixture
def history(tree, monkeypatch):
    """The same folder under git, whose commits and record have dates of ours."""
    (tree / "src/room/a.wgsl").write_text("let a = 1;\n")

    def commit(date):
        for name in ("AUTHOR", "COMMITTER"):
            monkeypatch.setenv(f"GIT_{name}_DATE", f"{date}T12:00:00+00:00")
        git = ["git", "-c", "user.name=A", "-c", "user.email=a@example.com"]
        subprocess.run(["git", "add", "."], cwd=tree, check=True)
        subprocess.run([*git, "commit", "--quiet", "-m", date], cwd=tree, check=True)

    subprocess.run(["git", "init", "--quiet"], cwd=tree, check=True)
    commit("2026-03-01")
    return tree, commit, {"date": "2026-03-02", "commit": nightly.head(tree)}


def since(tree, last):
    return nightly.stale_since(tree, ROOM, last).isoformat()


def test_a_part_is_stale_since_the_first_commit_that_changed_its_code(history):
    tree, commit, last = history
    (tree / "src/room/a.py").write_text("src/room/a.py  # a comment")
    (tree / "src/other.py").write_text("another = 1")
    commit("2026-03-03")
    (tree / "src/room/a.wgsl").write_text("let a = 2;\n")
    commit("2026-03-04")
    assert since(tree, last) == "2026-03-04"
    (tree / "src/room/a.py").write_text("changed")
    (tree / "tests/room/test_b.py").write_text("new")
    commit("2026-03-05")
    assert since(tree, last) == "2026-03-04"
    last["commit"] = "HEAD~1"
    assert since(tree, last) == "2026-03-05"


def test_without_such_a_commit_it_is_stale_since_it_was_green(history):
    tree, _, last = history
    (tree / "src/room/a.py").write_text("not committed")
    assert since(tree, last) == "2026-03-02"
    (tree / ".git").rename(tree / "git")
    assert nightly.head(tree) is None
    assert since(tree, last) == "2026-03-02"


def test_a_commit_that_is_gone_counts_as_none(history):
    tree, commit, last = history
    (tree / "src/room/a.py").write_text("changed")
    commit("2026-03-03")
    assert since(tree, {**last, "commit": "0123456789ab"}) == "2026-03-02"


def test_stale_parts_are_listed_and_no_failure(fake, monkeypatch, capsys):
    parts, ran, _ = fake
    parts["b"] = nightly.FAILED
    nightly.main(["a", "b", "c"])
    ran.clear()
    monkeypatch.setattr(
        nightly, "digest", lambda _, part: f"hash of {part.name}" + "!" * (part.name == "a")
    )
    today = datetime.now(UTC).date().isoformat()
    capsys.readouterr()
    assert nightly.main(["--stale"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        f"{'a':28} stale for 0 days, last green on {today}",
        f"{'b':28} never green",
    ]
    assert nightly.main(["--stale", "c"]) == 0
    assert capsys.readouterr().out == "no part is stale\n"
    assert ran == []


def test_unknown_parts_are_refused(fake, capsys):
    with pytest.raises(SystemExit):
        nightly.main(["d"])
    assert "no part 'd'; there are 'a', 'b', 'c'" in capsys.readouterr().err


# ---- How they end.


@pytest.mark.parametrize(
    ("code", "tests", "failures", "skipped", "expected"),
    [
        (0, 5, 0, 2, ("passed", "3 tests, 2 skipped")),
        (1, 5, 1, 0, ("FAILED", "5 tests")),
        (0, 4, 0, 4, ("nothing ran", "0 tests, 4 skipped")),
        (5, 0, 0, 0, ("nothing ran", "0 tests")),
        (None, 3, 0, 0, ("ended early", "3 tests")),
        (None, 3, 1, 0, ("FAILED", "3 tests")),
    ],
)
def test_a_part_is_judged_by_its_report(tmp_path, code, tests, failures, skipped, expected):
    report = tmp_path / "report.xml"
    suite = f'<testsuite tests="{tests}" failures="{failures}" errors="0" skipped="{skipped}"/>'
    report.write_text(f"<testsuites>{suite}</testsuites>")
    assert nightly.judge(code, report) == expected


@pytest.mark.parametrize(
    ("code", "expected"), [(0, "passed"), (3, "FAILED"), (None, "ended early")]
)
def test_a_command_is_judged_by_its_status(tmp_path, code, expected):
    assert nightly.judge(code, tmp_path / "report.xml") == (expected, "")


def test_pytest_is_ended_in_time_and_what_failed_until_then_counts(tmp_path, monkeypatch):
    (tmp_path / "test_slow.py").write_text(
        "import time\nimport pytest\n@pytest.mark.exhaustive\n"
        "@pytest.mark.parametrize('seconds', [0, 600])\n"
        "def test_it(seconds):\n    time.sleep(seconds)\n    assert seconds\n"
    )
    options = "addopts = --numprocesses=1\nmarkers = exhaustive\n"
    (tmp_path / "pytest.ini").write_text(f"[pytest]\n{options}")
    monkeypatch.delenv("PYTEST_ADDOPTS", raising=False)
    monkeypatch.setattr(nightly, "ROOT", tmp_path)
    outcome = nightly.run_part(Part("slow", [], tests=["test_slow.py"]), 20.0)
    assert (outcome.status, outcome.counts) == (nightly.FAILED, "1 tests")


@pytest.mark.skipif(sys.platform != "linux", reason="looks at Linux's list of processes")
def test_an_interrupt_leaves_no_processes(tmp_path):
    """Neither do processes started by a part's processes that ignore signals."""
    child = "import signal, time; signal.signal(2, 1); signal.signal(15, 1); time.sleep(60)"
    parent = (
        "import subprocess, sys, time; from pathlib import Path; "
        f"child = subprocess.Popen([sys.executable, '-c', {child!r}]); "
        f"Path({str(tmp_path / 'id')!r}).write_text(f'{{child.pid}}\\n'); time.sleep(60)"
    )
    code = (
        f"import runpy, signal, sys; n = runpy.run_path({str(SCRIPT)!r}); "
        "signal.signal(15, n['_interrupt']); "
        f"n['run_whole']([sys.executable, '-c', {parent!r}], {{}})"
    )
    script = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE, text=True)
    end = time.monotonic() + 60.0
    while not (tmp_path / "id").exists() or not (tmp_path / "id").read_text().endswith("\n"):
        assert time.monotonic() < end
        assert script.poll() is None, script.stderr.read()
        time.sleep(0.02)
    script.send_signal(signal.SIGTERM)
    assert "KeyboardInterrupt" in script.communicate(timeout=60)[1]
    number = int((tmp_path / "id").read_text())
    while is_running(number):
        assert time.monotonic() < end
        time.sleep(0.02)


def is_running(number):
    """Whether a process with this id is still running."""
    try:
        return Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


# ---- The configured parts.


def test_every_exhaustive_test_is_in_a_part():
    """By the text: a module that marks tests, or takes fixtures whose cases are marked."""
    paths = [ROOT / one for part in nightly.load_parts() for one in part.tests]
    files = [file for file in (ROOT / "tests").rglob("test_*.py") if file != Path(__file__)]
    words = r"exhaustive|make_tracer|EVERY_TR|EVERY_QUERY|every_tracer|is_ci="
    marked = [file for file in files if re.search(words, file.read_text("utf-8"))]
    assert len(marked) > 20
    assert [file for file in marked if not {file, *file.parents} & {*paths}] == []


def test_parts_have_names_and_files():
    parts = nightly.load_parts()
    assert len({part.name for part in parts}) == len(parts)
    for part in parts:
        assert nightly.covered_files(ROOT, part)
        assert bool(part.tests) != bool(part.command), part.name
    assert set(nightly.load_record()) <= {part.name for part in parts}
