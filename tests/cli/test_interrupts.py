"""One Ctrl-C is enough, and the process ends with 130, wherever Python was."""

import subprocess
import sys
import time

import pytest

from raystream.cli.interrupts import keep_interrupts


class Interrupted:
    def __del__(self):
        raise KeyboardInterrupt


def wait(things):
    things.clear()  # Python can only report what __del__ raises
    time.sleep(60)


def test_a_lost_interrupt_comes_again():
    things = [Interrupted()]
    start = time.monotonic()
    with pytest.raises(KeyboardInterrupt), keep_interrupts():
        wait(things)
    assert time.monotonic() - start < 30, "the wait was not interrupted"


def test_other_errors_are_reported_as_before(monkeypatch):
    class Broken:
        def __del__(self):
            raise ValueError("broken")

    seen = []
    monkeypatch.setattr(sys, "unraisablehook", lambda what: seen.append(what.exc_type))
    broken = Broken()
    with keep_interrupts():
        del broken
    assert seen == [ValueError]


@pytest.mark.parametrize(
    "command",
    [
        pytest.param("exec('raise KeyboardInterrupt')", id="in a string"),
        pytest.param("os.kill(os.getpid(), signal.SIGINT); time.sleep(30)", id="by the signal"),
    ],
)
def test_the_exit_code_is_130(environment, tmp_path, command):
    (tmp_path / "interrupted.py").write_text(
        "import os, signal, time\n"
        "from raystream import cli\n"
        "@cli.app.command()\n"
        "def stop():\n"
        "    signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        f"    {command}\n"
        "cli.main(['stop'])\n"
    )
    done = subprocess.run(
        [sys.executable, "-m", "interrupted"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 130, done.stderr
    assert done.stderr == "interrupted\n"
