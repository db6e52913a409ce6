"""The worker: gives visitors their turns, and lets nobody wait for one that takes too long."""

from __future__ import annotations

import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Protocol

from raystream.viewer.turns import Turns

__all__ = ["Customer", "Worker"]

#: What a slice of work may take: alone, and while others wait for their turn.
_ALONE, _AMONG_OTHERS = 0.1, 0.04

#: A slice that takes so long goes on beside the others' turns: what it is at cannot be divided,
#: as a row of brute force, or is being compiled. So many may do so; more are waited for.
_PATIENCE, _MOST_BESIDE = 0.25, 2

#: The worker looks again after so long, for cameras that have come to rest.
_LOOK_SECONDS = 0.1


class Customer(Protocol):
    """Who gets turns; a visitor."""

    def __hash__(self) -> int: ...

    def has_work(self) -> bool:
        """Whether there is anything to do."""

    def step(self, seconds: float) -> None:
        """Do a slice of it, which may take so long."""

    def rest(self) -> None:
        """Drop what was done."""


class Worker:
    """A thread that gives turns to those who have work, until it is closed.

    No two slices of one customer run at a time, and mostly no two at all.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._customers: list[Customer] = []
        self._left: list[Customer] = []
        self._is_closed = self._is_woken = False
        # What follows is the thread's own.
        self._turns: Turns[Customer] = Turns()
        self._beside: dict[Future[float], Customer] = {}
        self._hands = ThreadPoolExecutor(1 + _MOST_BESIDE, "raystream viewer turn")
        self._thread = threading.Thread(target=self._run, name="raystream viewer", daemon=True)
        self._thread.start()

    @property
    def customers(self) -> list[Customer]:
        """Those who are there."""
        with self._changed:
            return list(self._customers)

    def add(self, customer: Customer) -> bool:
        """Give turns to one more; returns whether the worker is still there to do so."""
        with self._changed:
            if not self._is_closed:
                self._customers.append(customer)
            return not self._is_closed

    def drop(self, customer: Customer) -> None:
        """Give no more turns to one that has left."""
        with self._changed:
            if customer in self._customers:
                self._customers.remove(customer)
            self._left.append(customer)
            self._changed.notify_all()

    def wake(self) -> None:
        """Look for work."""
        with self._changed:
            self._is_woken = True
            self._changed.notify_all()

    def close(self, timeout: float = 10.0) -> None:
        """End the threads, after the slices that are being done."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()
        self._thread.join(timeout)
        wait(list(self._beside), timeout)
        self._hands.shutdown(wait=False)

    def _run(self) -> None:
        while True:
            with self._changed:
                if self._is_closed:
                    return
                self._is_woken = False
                customers, left = list(self._customers), list(self._left)
                self._left.clear()
            for turn in [turn for turn in self._beside if turn.done()]:
                self._turns.charge(self._beside.pop(turn), turn.result())
            busy = list(self._beside.values())
            self._say_goodbye(left, busy)
            ready = [one for one in customers if one not in busy and one.has_work()]
            if ready:
                self._take_turn(self._turns.choose(ready), len(ready) + len(busy))
                continue
            with self._changed:
                if not self._is_woken and not self._is_closed:
                    self._changed.wait(_LOOK_SECONDS if customers or self._left else None)

    def _say_goodbye(self, left: list[Customer], busy: list[Customer]) -> None:
        for customer in left:
            if customer in busy:  # later, then
                with self._changed:
                    self._left.append(customer)
            else:
                customer.rest()
                self._turns.forget(customer)

    def _take_turn(self, customer: Customer, count: int) -> None:
        seconds = _ALONE if count == 1 else _AMONG_OTHERS
        turn = self._hands.submit(_timed_step, customer, seconds)
        is_last = len(self._beside) >= _MOST_BESIDE
        done, _ = wait([turn], None if is_last else _PATIENCE)
        if done:
            self._turns.charge(customer, turn.result())
        else:
            self._beside[turn] = customer
            turn.add_done_callback(lambda _: self.wake())


def _timed_step(customer: Customer, seconds: float) -> float:
    """Do a slice; returns the seconds that it took."""
    started = time.perf_counter()
    customer.step(seconds)
    return time.perf_counter() - started
