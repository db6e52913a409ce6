"""Progress bars on stderr."""

from __future__ import annotations

import io
import re
import sys
import time
from collections.abc import Callable

import pytest

from raystream.cli import bars, main


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def to_terminal(monkeypatch) -> Callable[[], Terminal]:
    """Make stderr a terminal; called by the test, for pytest sets stderr after fixtures."""

    def replace() -> Terminal:
        stream = Terminal()
        monkeypatch.setattr(sys, "stderr", stream)
        monkeypatch.setenv("TERM", "xterm")
        for name in ("NO_COLOR", "FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE"):
            monkeypatch.delenv(name, raising=False)
        return stream

    return replace


def wait_for(stream: Terminal, text: str) -> None:
    end = time.monotonic() + 10
    while text not in stream.getvalue():
        assert time.monotonic() < end, f"{text!r} is not in {stream.getvalue()!r}"
        time.sleep(0.01)


def test_long_work_shows_its_steps(to_terminal, monkeypatch):
    terminal = to_terminal()
    monkeypatch.setattr(bars, "DELAY", 0.0)
    with bars.Bars() as shown:
        with shown.step("loading"):
            wait_for(terminal, "loading")
        with shown.step("tracing") as progress:
            progress(1, 4)
            wait_for(terminal, "25%")
    written = terminal.getvalue()
    assert written.rindex("\x1b[2K") > written.rindex("tracing")  # the bar is wiped off


def test_a_render_shows_its_error_so_far(to_terminal, monkeypatch, tmp_path):
    to_terminal()
    monkeypatch.setattr(bars, "DELAY", 0.0)
    monkeypatch.setenv("RAYSTREAM_CHECKPOINT_SECONDS", "0")  # after each sample
    shown = []
    monkeypatch.setattr(bars.Step, "describe", lambda _, state: shown.append(state))
    wanted = ["render", "cornell", "--mode", "path", "--size", "16x12", "--samples", "6"]
    with pytest.raises(SystemExit) as end:
        main([*wanted, "-o", str(tmp_path / "out.png")])
    assert end.value.code == 0
    assert shown
    assert all(re.fullmatch(r"error \d+\.\d\d%", state) for state in shown)


def test_a_state_is_shown_behind_the_title(to_terminal, monkeypatch):
    terminal = to_terminal()
    monkeypatch.setattr(bars, "DELAY", 0.0)
    with bars.Bars() as shown, shown.step("rendering") as step:
        step.describe("error 3.20%")
        wait_for(terminal, "rendering, error 3.20%")


def test_title_is_no_markup(to_terminal, monkeypatch):
    terminal = to_terminal()
    monkeypatch.setattr(bars, "DELAY", 0.0)
    with bars.Bars() as shown, shown.step("0:100:5 [bold]"):
        wait_for(terminal, "0:100:5 [bold]")


def test_short_work_shows_nothing(to_terminal):
    terminal = to_terminal()
    with bars.Bars() as shown, shown.step("loading") as progress:
        progress(1, 2)
    assert terminal.getvalue() == ""


def test_bar_is_wiped_off_after_an_error(to_terminal, monkeypatch):
    terminal = to_terminal()
    monkeypatch.setattr(bars, "DELAY", 0.0)

    def work() -> None:
        with bars.Bars() as shown, shown.step("loading"):
            wait_for(terminal, "loading")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        work()
    assert "\x1b[?25h" in terminal.getvalue()  # the cursor is back


@pytest.mark.parametrize("kind", ["no terminal", "dumb terminal"])
def test_nobody_to_see_it(to_terminal, monkeypatch, kind):
    terminal = to_terminal()
    monkeypatch.setattr(bars, "DELAY", 0.0)
    if kind == "dumb terminal":
        monkeypatch.setenv("TERM", "dumb")
    else:
        monkeypatch.setattr(Terminal, "isatty", lambda self: False)
    with bars.Bars() as shown, shown.step("loading") as progress:
        assert progress is None
        time.sleep(0.05)
    assert terminal.getvalue() == ""


def test_speed_is_shown_of_what_is_counted(to_terminal, monkeypatch):
    terminal = to_terminal()
    monkeypatch.setattr(bars, "DELAY", 0.0)
    monkeypatch.setenv("COLUMNS", "80")
    with bars.Bars() as shown, shown.step("rendering", "paths") as progress:
        end = time.monotonic() + 10
        done = 0
        while "Mpaths/s" not in terminal.getvalue():
            assert time.monotonic() < end
            done += 20_000
            progress(done, 1 << 40)
            time.sleep(0.01)
