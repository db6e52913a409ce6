"""Timing of calls in turn."""

from __future__ import annotations

from functools import partial

from extras import need

need("raystream_lab")

from raystream_lab.timing import median_times, time_in_turn


def test_calls_take_turns():
    ran: list[str] = []
    calls = {name: partial(ran.append, name) for name in "ab"}
    assert [len(seconds) for seconds in time_in_turn(calls, 2).values()] == [2, 2]
    assert ran == ["a", "b", "a", "b"]
    assert all(seconds >= 0.0 for seconds in median_times(calls, 1).values())
    assert ran[4:] == ["a", "b", "a", "b"]  # an untimed round first


def test_slow_calls_run_once():
    ran: list[str] = []
    found = time_in_turn({"a": lambda: ran.append("a")}, 3, patience=-1.0)
    assert ran == ["a"]
    assert len(found["a"]) == 1
