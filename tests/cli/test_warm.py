"""Compilation before the first use, and the note at the first use."""

import time

import pytest

from raystream.cli import compiling
from raystream.cli.load import Stopwatch
from raystream.cli.tracer_options import TracerArguments
from raystream.jit import warm
from raystream.jit.compile_events import LISTENERS

DEFAULT = TracerArguments(None, "cpu", {})


def test_tasks_are_those_of_the_list():
    from raystream.cli.warm import TASKS

    assert TASKS == warm.TASKS


def test_figures(run, monkeypatch):
    asked = []

    def record(entries, task, process_count, progress):
        asked.append((task, process_count, len(entries)))
        progress(0.5)
        return 3

    monkeypatch.setattr(warm, "warm", record)
    count = len(warm.entries_of("query"))
    figures = run("warm", "query", "--threads", "2", "--json").figures
    assert asked == [("query", 2, count)]
    assert (figures["task"], figures["kernels"], figures["compiled"]) == ("query", count, 3)
    assert f"{count} kernels, 3 of them compiled now" in run("warm", "query").out


def test_other_tasks_are_refused(run):
    assert run("warm", "everything").complaint.startswith("TASK: expected one of render, query")


@pytest.fixture
def started(monkeypatch):
    """Helpers and kernels that a first use would start and compile."""
    found = []
    monkeypatch.setattr(compiling, "thread_count", lambda: 3)
    monkeypatch.setattr(warm, "missing", lambda entries: list(entries))
    monkeypatch.setattr(
        warm, "start_helpers", lambda task, count: found.append((task, count)) or []
    )
    monkeypatch.setattr(warm, "compile_kernels", lambda entries: found.append(len(entries)))
    return found


def test_the_first_kernel_that_is_missing_starts_the_rest(started, capsys):
    first = warm.entries_of("render-ao")[0].kernel
    with compiling.compiling("render-ao", DEFAULT, Stopwatch()):
        (listener,) = LISTENERS
        listener.begin(first)
        listener.begin("another")
        listener.end(first, 5.0)
    count = len(warm.entries_of("render-ao"))
    assert started == [("render-ao", 2), count - 1]
    shown = capsys.readouterr().err
    assert shown.count("\n") == 1
    assert shown.startswith(f"compiling {count} kernels on first use; cached in ")
    assert LISTENERS == []


def test_nothing_is_compiled_where_it_cannot_be_kept(run, monkeypatch, tmp_path):
    (tmp_path / "file").touch()
    monkeypatch.setenv("RAYSTREAM_CACHE_DIR", str(tmp_path / "file"))
    folder = tmp_path / "file" / "kernels"
    assert run("warm", "query").complaint.startswith(f"warm: {folder} cannot be written; set")


def test_a_folder_that_cannot_be_written_is_named(started, capsys, monkeypatch, tmp_path):
    (tmp_path / "file").touch()
    monkeypatch.setenv("RAYSTREAM_CACHE_DIR", str(tmp_path / "file" / "cache"))
    monkeypatch.setattr(warm, "missing", lambda entries: entries[:1])
    with compiling.compiling("render-ao", DEFAULT, Stopwatch()):
        (listener,) = LISTENERS
        listener.begin("one")
    folder = tmp_path / "file" / "cache" / "kernels"
    assert started == [("render-ao", 0), 1]
    assert capsys.readouterr().err == (
        f"compiling 1 kernel on first use; cannot be cached in {folder}\n"
    )


@pytest.mark.parametrize(
    "chosen", [TracerArguments("grid", "cpu", {}), TracerArguments(None, "cuda", {})]
)
def test_other_structures_say_it_when_a_second_has_passed(chosen, started, capsys):
    with compiling.compiling("query-first", chosen, Stopwatch()):
        (listener,) = LISTENERS
        listener.begin("one")
        listener.end("one", 0.9)
        assert capsys.readouterr().err == ""
        listener.end("two", 0.2)
        listener.end("three", 9.0)
    assert capsys.readouterr().err.count("compiling kernels on first use") == 1
    assert started == []


def test_compilation_within_a_step_is_not_part_of_it(started):
    stopwatch = Stopwatch()
    with compiling.compiling("render-ao", DEFAULT, stopwatch), stopwatch.measure("trace"):
        (listener,) = LISTENERS
        for name in ("one", "two"):
            listener.begin(name)
            time.sleep(0.2)
            listener.end(name, 99.0)
    assert list(stopwatch.seconds) == ["compile", "trace"]
    assert stopwatch.seconds["compile"] >= 0.4
    assert 0.0 < stopwatch.seconds["trace"] < stopwatch.seconds["compile"]


def test_nothing_is_said_where_nothing_is_compiled(started, capsys):
    with compiling.compiling("query-first", TracerArguments("bvh", "cpu", {}), Stopwatch()):
        pass
    assert capsys.readouterr().err == ""
    assert started == []


def test_seconds_of_compiling_are_a_step_of_their_own(started, monkeypatch):
    monkeypatch.setattr(warm, "compile_kernels", lambda entries: time.sleep(0.2))
    stopwatch = Stopwatch()
    with compiling.compiling("render-ao", DEFAULT, stopwatch), stopwatch.measure("build"):
        LISTENERS[0].begin("one")
    assert list(stopwatch.seconds) == ["compile", "build"]
    assert stopwatch.seconds["compile"] >= 0.2 > stopwatch.seconds["build"] > 0.0
