"""One process at a time compiles a kernel; if it dies, the others continue."""

import subprocess
import sys

import pytest
from numba.core.errors import TypingError

from conftest import child_environment
from raystream.jit import cache, compile_lock
from raystream.jit.compile_lock import CompileLock
from raystream.jit.cpu import kernel

#: Acquires the lock, says so, and releases it when told.
HOLDER = """
import sys
from pathlib import Path
from raystream.jit.compile_lock import CompileLock
lock = CompileLock(Path(sys.argv[1]))
print(lock.acquire("a"), flush=True)
input()
lock.release("a")
print("released", flush=True)
input()
"""


@pytest.fixture
def holder(tmp_path):
    """Another process, which holds the lock "a"."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDER, tmp_path],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=child_environment(),
    )
    with process:
        assert process.stdout.readline() == "True\n"
        yield process
        process.kill()


def test_one_process_holds_a_lock_at_a_time(holder, tmp_path, monkeypatch):
    monkeypatch.setattr(compile_lock, "TIMEOUT", 0.1)
    ours = CompileLock(tmp_path)
    assert ours.acquire("b")
    assert not ours.acquire("a")  # but it waits no longer than its timeout
    holder.stdin.write("\n")
    holder.stdin.flush()
    assert holder.stdout.readline() == "released\n"
    assert ours.acquire("a")


def test_locks_are_released_one_by_one(tmp_path):
    ours = CompileLock(tmp_path)
    assert ours.acquire("a")
    assert ours.acquire("b")
    ours.release("a")
    code = """
import sys
from pathlib import Path
from raystream.jit import compile_lock
compile_lock.TIMEOUT = 0.1
theirs = compile_lock.CompileLock(Path(sys.argv[1]))
print(theirs.acquire("a"), theirs.acquire("b"))
"""
    command = [sys.executable, "-c", code, tmp_path]
    printed = subprocess.check_output(command, text=True, env=child_environment())
    assert printed == "True False\n"


def test_the_lock_of_a_killed_process_is_released(holder, tmp_path):
    holder.kill()
    assert CompileLock(tmp_path).acquire("a")


def test_without_a_file_there_is_no_lock(tmp_path):
    (tmp_path / "file").write_text("not a folder")
    ours = CompileLock(tmp_path / "file" / "cache")
    assert not ours.acquire("a")
    ours.release("a")


def test_a_failed_compilation_releases_its_lock(monkeypatch):
    events = []

    class Recorder:
        def acquire(self, name):
            events.append(("acquire", name))
            return True

        def release(self, name):
            events.append(("release", name))

    monkeypatch.setattr(cache, "_lock_in", lambda folder: Recorder())
    with pytest.raises(TypingError):
        kernel(wrong)(1)
    (first, name), (second, same) = events
    assert (first, second, same) == ("acquire", "release", name)


def wrong(x):
    return x.no_such_attribute
