import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import raystream
from raystream.jit import cache as cache_module

PACKAGE = Path(raystream.__file__).parent

#: A kernel in one file that calls a function in another.
CALLEE = """
from raystream.jit.cpu import device

@device
def answer(x):
    return x + 1
"""
CALLER = """
from raystream.jit.cpu import kernel
from raystream.kernels.callee import answer

@kernel
def ask(x):
    return answer(x)
"""

#: Runs it; says how often it came from the cache, and how often it was compiled.
PROGRAM = """
from raystream.kernels.caller import ask
print(ask(1))
print(sum(ask.stats.cache_hits.values()), sum(ask.stats.cache_misses.values()))
"""


def run(source: Path, folder: Path, **changes) -> list[str]:
    environment = {
        **os.environ,
        "PYTHONPATH": str(source),
        "RAYSTREAM_CACHE_DIR": str(folder),
        **changes,
    }
    command = [sys.executable, "-c", PROGRAM]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, env=environment)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.fixture
def source(tmp_path):
    """A copy of the package, to be edited."""
    package = tmp_path / "src" / "raystream"
    shutil.copytree(PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__"))
    (package / "kernels" / "callee.py").write_text(CALLEE)
    (package / "kernels" / "caller.py").write_text(CALLER)
    return tmp_path / "src"


def test_kernels_are_compiled_once_and_again_after_any_edit(source, tmp_path):
    folder = tmp_path / "cache"
    assert run(source, folder) == ["2", "0", "1"]
    assert run(source, folder) == ["2", "1", "0"]
    callee = source / "raystream" / "kernels" / "callee.py"
    callee.write_text(CALLEE.replace("+ 1", "+ 100"))
    assert run(source, folder) == ["101", "0", "1"]
    callee.write_text(CALLEE)
    assert run(source, folder) == ["2", "1", "0"]  # the older version's files are still there


def test_damaged_files_are_compiled_over(source, tmp_path):
    folder = tmp_path / "cache"
    run(source, folder)
    files = [*folder.rglob("*.nbi"), *folder.rglob("*.nbc")]
    assert files
    for path in files:
        path.write_bytes(path.read_bytes()[:-20])
    assert run(source, folder) == ["2", "0", "1"]
    assert run(source, folder) == ["2", "1", "0"]


def test_a_folder_that_cannot_be_written_is_no_error(source, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    assert run(source, blocked / "cache") == ["2", "0", "1"]


def test_two_processes_at_once_share_one_folder(source, tmp_path):
    folder = tmp_path / "cache"
    environment = {**os.environ, "PYTHONPATH": str(source), "RAYSTREAM_CACHE_DIR": str(folder)}
    command = [sys.executable, "-c", PROGRAM]
    both = [
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
        for _ in range(2)
    ]
    answers = [process.communicate(timeout=300)[0].split() for process in both]
    assert sorted(answers) == [["2", "0", "1"], ["2", "1", "0"]]  # one waited for the other
    assert all(process.returncode == 0 for process in both)
    assert run(source, folder) == ["2", "1", "0"]
    assert not list(folder.rglob("*.tmp.*"))


def test_data_files_are_named_by_what_they_hold():
    """So that two processes cannot give different kernels the same file."""
    files = cache_module._CacheFile("nowhere", "kernel-1.py311", "stamp")
    names = {files._name_of((signature, "cpu", "name", ())) for signature in ("a", "b", "c")}
    assert len(names) == 3
    assert files._name_of(("a", "cpu", "name", ())) in names


def test_what_a_cached_kernel_may_close_over():
    from raystream.structures.brute.traversal import traverse

    assert cache_module._name_of_cell(traverse).endswith("brute.traversal.traverse")
    assert cache_module._name_of_cell(3) == "3"
    with pytest.raises(TypeError, match="cannot close over"):
        cache_module._name_of_cell(object())


def test_the_folder_follows_the_platform(monkeypatch, tmp_path):
    monkeypatch.delenv("RAYSTREAM_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(sys, "platform", "linux")
    assert cache_module.cache_folder() == tmp_path / "raystream"
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path / "local"))
    assert cache_module.cache_folder() == tmp_path / "local" / "raystream"
    monkeypatch.setenv("RAYSTREAM_CACHE_DIR", str(tmp_path / "chosen"))
    assert cache_module.cache_folder() == tmp_path / "chosen"
