"""FairScheduler: all clients get the same share of the time."""

from __future__ import annotations

from collections import Counter

from raystream.viewer.fair_scheduler import FairScheduler


def work(scheduler, ready, seconds, total):
    """Work for this long in total; returns each client's share."""
    used = Counter()
    while sum(used.values()) < total:
        key = scheduler.choose(ready)
        scheduler.charge(key, seconds[key])
        used[key] += seconds[key]
    return used


def test_long_slices_do_not_give_more_time():
    used = work(FairScheduler(), ["slow", "quick"], {"slow": 5.0, "quick": 0.1}, 100.0)
    assert abs(used["slow"] - used["quick"]) <= 5.1


def test_who_comes_later_is_soon_next_but_gets_no_credit():
    scheduler = FairScheduler()
    seconds = {"first": 1.0, "second": 1.0}
    work(scheduler, ["first"], seconds, 50.0)
    scheduler.charge("first", 0.0)
    used = work(scheduler, ["first", "second"], seconds, 10.0)
    assert used == {"first": 5.0, "second": 5.0}


def test_who_slept_gets_no_credit_either():
    scheduler = FairScheduler()
    seconds = dict.fromkeys("abc", 1.0)
    work(scheduler, ["a", "b", "c"], seconds, 9.0)
    work(scheduler, ["a", "b"], seconds, 40.0)
    used = work(scheduler, ["a", "b", "c"], seconds, 9.0)
    assert used["c"] <= 4.0
    assert min(used.values()) >= 2.0


def test_nobody_waits_for_more_than_a_round():
    scheduler, keys = FairScheduler(), list(range(8))
    seconds = {key: 0.1 * (1 + key) for key in keys}
    last = dict.fromkeys(keys, 0)
    for turn in range(1, 400):
        key = scheduler.choose(keys)
        scheduler.charge(key, seconds[key])
        assert turn - last[key] < 60
        last[key] = turn
    assert min(last.values()) > 340


def test_who_has_left_is_forgotten():
    scheduler = FairScheduler()
    scheduler.charge("nobody", 3.0)
    assert scheduler.choose(["a", "b"]) == "a"
    scheduler.charge("a", 1.0)
    scheduler.forget("a")
    assert scheduler.choose(["b"]) == "b"
    scheduler.forget("never there")
