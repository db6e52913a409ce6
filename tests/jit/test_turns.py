"""One process at a time compiles a kernel; whatever happens to it, the others go on."""

import subprocess
import sys

import pytest
from numba.core.errors import TypingError

from conftest import child_environment
from raystream.jit import cache, turns
from raystream.jit.cpu import kernel
from raystream.jit.turns import Turns

#: Takes a turn, says so, gives it back when told, and goes on.
HOLDER = """
import sys
from pathlib import Path
from raystream.jit.turns import Turns
turns = Turns(Path(sys.argv[1]))
print(turns.take("a"), flush=True)
input()
turns.give("a")
print("given", flush=True)
input()
"""


@pytest.fixture
def holder(tmp_path):
    """Another process, which has the turn "a"."""
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


def test_one_process_has_a_turn_at_a_time(holder, tmp_path, monkeypatch):
    monkeypatch.setattr(turns, "PATIENCE", 0.1)
    ours = Turns(tmp_path)
    assert ours.take("b")
    assert not ours.take("a")  # but it waits no longer than its patience
    holder.stdin.write("\n")
    holder.stdin.flush()
    assert holder.stdout.readline() == "given\n"
    assert ours.take("a")


def test_turns_are_given_back_one_by_one(tmp_path):
    ours = Turns(tmp_path)
    assert ours.take("a")
    assert ours.take("b")
    ours.give("a")
    code = """
import sys
from pathlib import Path
from raystream.jit import turns
turns.PATIENCE = 0.1
theirs = turns.Turns(Path(sys.argv[1]))
print(theirs.take("a"), theirs.take("b"))
"""
    command = [sys.executable, "-c", code, tmp_path]
    printed = subprocess.check_output(command, text=True, env=child_environment())
    assert printed == "True False\n"


def test_the_turn_of_a_process_that_was_killed_is_over(holder, tmp_path):
    holder.kill()
    assert Turns(tmp_path).take("a")


def test_without_a_file_there_are_no_turns(tmp_path):
    (tmp_path / "file").write_text("not a folder")
    ours = Turns(tmp_path / "file" / "cache")
    assert not ours.take("a")
    ours.give("a")


def test_a_kernel_that_cannot_be_compiled_gives_its_turn_back(monkeypatch):
    events = []

    class Recorder:
        def take(self, name):
            events.append(("take", name))
            return True

        def give(self, name):
            events.append(("give", name))

    monkeypatch.setattr(cache, "_turns", lambda folder: Recorder())
    with pytest.raises(TypingError):
        kernel(wrong)(1)
    (first, name), (second, same) = events
    assert (first, second, same) == ("take", "give", name)


def wrong(x):
    return x.no_such_attribute
