"""Parallel loops over ranges: threads that run compiled kernels without the interpreter lock."""

from __future__ import annotations

import itertools
import os
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait

from raystream.core.checks import check_least
from raystream.jit.processors import Helpers

#: Called with the steps done and their total, from the calling thread.
Progress = Callable[[int, int], object]

#: Seconds between two calls of a progress callback.
PROGRESS_INTERVAL = 0.05

#: Chunks per call of the body of a nested loop that runs on one thread, if the body allows it.
_CHUNKS_ALONE = 16


def chunk_size(count: int, most: int) -> int:
    """Length of a loop's chunks: an eighth of the loop, but from 4,096 to `most`.

    A small loop has a part for each thread then; a large one does not wait for many calls.
    """
    return min(max(count >> 3, 1 << 12), most)


def part_of(progress: Progress | None, first: int, count: int, total: int) -> Progress | None:
    """Progress callback of `count` of `total` steps, after the `first` ones.

    The part may count in steps of its own.
    """
    if progress is None:
        return None
    whole = progress

    def report(done: int, steps: int) -> object:
        return whole(first + (count * done // steps if steps else count), total)

    return report


def parts(
    count: int, size: int | Callable[[int], int], progress: Progress | None = None
) -> Iterator[tuple[slice, Progress | None]]:
    """Cut a range into parts that are done one after another.

    Parameters
    ----------
    count : int
        Length of the range.
    size : int or callable
        Length of a part; or ``size(left)`` of the next one, if that many items are left.
    progress : callable, optional
        Called with (items done, count).

    Yields
    ------
    slice, callable or None
        A part, and its progress callback.
    """
    begin = 0
    while begin < count:
        length = size if isinstance(size, int) else size(count - begin)
        end = min(begin + length, count)
        yield slice(begin, end), part_of(progress, begin, end - begin, count)
        begin = end


def rising(progress: Progress | None) -> Progress | None:
    """Progress callback of loops that may have to run again: its reports never decrease."""
    if progress is None:
        return None
    whole, most, of = progress, 0, 1

    def report(done: int, total: int) -> object:
        nonlocal most, of
        if done * of >= most * total:
            most, of = done, total
        return whole(most, of)

    return report


_chosen_count: int | None = None
_pool: ThreadPoolExecutor | None = None
_pool_size = 0
_helpers = Helpers()
_lock = threading.Lock()


def thread_count() -> int:
    """Number of threads that loops run on.

    Set by `set_thread_count`, else by ``RAYSTREAM_THREADS``, else the number of cores that this
    process may use.

    Raises
    ------
    ValueError
        If ``RAYSTREAM_THREADS`` is not a positive integer.
    """
    if _chosen_count is not None:
        return _chosen_count
    text = os.environ.get("RAYSTREAM_THREADS", "").strip()
    if text:
        if not text.isdecimal() or int(text) < 1:
            raise ValueError(f"RAYSTREAM_THREADS: expected a positive integer, got {text!r}")
        return int(text)
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def set_thread_count(count: int | None) -> None:
    """Set the number of threads of this process; None restores the default.

    Raises
    ------
    ValueError
        If `count` is below 1.
    TypeError
        If it is not an integer.
    """
    global _chosen_count
    _chosen_count = None if count is None else check_least("threads", count, 1)


def _thread_pool() -> tuple[ThreadPoolExecutor, Helpers]:
    """The shared pool, with `thread_count` threads."""
    global _pool, _pool_size, _helpers
    count = thread_count()
    with _lock:
        if _pool is None or _pool_size != count:
            # An older pool shuts down when the loops that use it are done.
            _helpers = Helpers()
            _pool = ThreadPoolExecutor(count, "raystream", _helpers.add_current_thread)
            _pool_size = count
        return _pool, _helpers


def _forget_pool() -> None:
    """A forked child has none of its parent's threads, and perhaps a lock held by one."""
    global _pool, _lock
    _pool = None
    _lock = threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_pool)


def parallel_for(
    body: Callable[[int, int], object],
    count: int,
    chunk: int,
    progress: Progress | None = None,
    *,
    joins_chunks: bool = False,
) -> None:
    """Run ``body(begin, end)`` over [0, count) in chunks, on all threads.

    The calling thread takes part, so that a small loop needs no other thread, and Ctrl-C takes
    effect between two of its chunks: the other threads then finish their current chunk, and
    KeyboardInterrupt is raised. An exception in any chunk stops the loop likewise.
    A nested loop stops with the loop around it, and runs on the body's thread alone while the
    outer loop keeps all threads busy: more threads than processors would wait for each other,
    which took a quarter of the time of an image.

    Parameters
    ----------
    body : callable
        Called with begin < end; must release the interpreter lock to run in parallel.
        Before threads start it is called with (0, 0), which must do nothing, so that kernels
        are compiled on the calling thread. (An interrupt in one thread while another compiles
        can leave the compiler's lock held forever.)
    count : int
        Length of the range.
    chunk : int
        Largest range for one call of `body`: decides the balance between threads, and how soon
        an interrupt takes effect. Each range begins at a multiple of it.
    progress : callable, optional
        Called with (done, count) from the calling thread, at most every `PROGRESS_INTERVAL`
        seconds, and once at the end.
    joins_chunks : bool
        Whether `body` takes longer ranges, too: a nested loop that has one thread then calls it
        for 16 chunks at once, since each call may wait for another thread to release the
        interpreter lock. Not for a body whose memory is made for one chunk.
    """
    if count <= 0:
        return
    if count <= chunk and progress is None:  # fast path of small loops
        check_stopped()
        body(0, count)
        return
    around = getattr(_current, "loop", None)
    state = _LoopState(around)
    spare = thread_count() - 1 if around is None else thread_count() - around.busy_threads()
    thread_total = min(1 + max(spare, 0), -(-count // chunk))
    state.thread_total = thread_total
    if joins_chunks and around is not None and thread_total == 1 and progress is None:
        chunk *= _CHUNKS_ALONE
    begins = itertools.count(0, chunk)  # next() is atomic under the interpreter lock
    finished = itertools.count(1)

    def work(report: Progress | None) -> None:
        shown = time.monotonic()
        around = getattr(_current, "loop", None)
        _current.loop = state
        try:
            while not state.is_stopped():
                begin = next(begins)
                if begin >= count:
                    return
                body(begin, min(begin + chunk, count))
                state.chunks_done = next(finished)
                if report and time.monotonic() - shown >= PROGRESS_INTERVAL:
                    shown = time.monotonic()
                    report(min(state.chunks_done * chunk, count), count)
        finally:
            _current.loop = around
            state.ended.append(True)

    def work_in_pool() -> None:
        try:
            work(None)
        except BaseException:
            state.stop = True
            raise

    others: list[Future[None]] = []
    try:
        if thread_total > 1:
            body(0, 0)
            pool, helpers = _thread_pool()
            helpers.keep_off_this_processor()
            others = [pool.submit(work_in_pool) for _ in range(thread_total - 1)]
        work(progress)
        # Tasks that have not started have nothing left to do: do not wait for other loops'.
        others = [other for other in others if not other.cancel()]
        _wait(others, lambda: state.chunks_done * chunk, count, progress)
        if state.is_stopped():  # by the outer loop, whose exception propagates
            raise _StoppedError
    except BaseException as error:
        state.stop = True
        for other in others:
            other.cancel()
        errors = [other.exception() for other in others if not other.cancelled()]
        if isinstance(error, _StoppedError):  # raise the cause, if it was in this loop
            for cause in errors:
                if cause is not None and not isinstance(cause, _StoppedError):
                    raise cause from None
        raise
    if progress:
        progress(count, count)


#: The loop whose body runs on this thread.
_current = threading.local()


def check_stopped() -> None:
    """End the body of a loop that was stopped; for small loops within, which call no other."""
    around = getattr(_current, "loop", None)
    if around is not None and around.is_stopped():
        raise _StoppedError


class _StoppedError(Exception):
    """Ends the body of a loop that was stopped; never leaves the outermost loop."""


class _LoopState:
    def __init__(self, around: _LoopState | None) -> None:
        self.stop = False
        self.chunks_done = 0
        self.thread_total = 1
        self.ended: list[bool] = []  # append() is atomic under the interpreter lock
        self._around = around

    def busy_threads(self) -> int:
        """Threads that run this loop and those around it."""
        own = self.thread_total - len(self.ended)
        # One of the outer loop's threads runs this one.
        return own if self._around is None else own - 1 + self._around.busy_threads()

    def is_stopped(self) -> bool:
        """Whether this loop, or one around it, has been stopped."""
        return self.stop or (self._around is not None and self._around.is_stopped())


def _wait(
    others: list[Future[None]],
    done: Callable[[], int],
    count: int,
    progress: Progress | None,
) -> None:
    """Wait for the other threads, in slices, so that Ctrl-C gets through on every platform."""
    for other in others:
        while not wait([other], timeout=PROGRESS_INTERVAL).done:
            if progress:
                progress(min(done(), count), count)
        other.result()
