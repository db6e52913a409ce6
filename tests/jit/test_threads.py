import os
import subprocess
import sys
import threading
import time

import pytest

from conftest import child_environment
from raystream.jit import processors, threads
from raystream.jit.threads import parallel_for, set_thread_count, thread_count


@pytest.fixture(autouse=True)
def default_threads():
    yield
    set_thread_count(None)


@pytest.mark.parametrize("count", [1, 2, 7])
@pytest.mark.parametrize(("length", "chunk"), [(0, 4), (1, 4), (10, 3), (100, 1), (5, 100)])
def test_every_index_is_done_once(count, length, chunk):
    set_thread_count(count)
    done = [0] * length

    def body(begin, end):
        assert 0 < end - begin <= chunk or begin == end == 0
        for i in range(begin, end):
            done[i] += 1

    parallel_for(body, length, chunk)
    assert done == [1] * length


def test_threads_run_at_the_same_time():
    set_thread_count(3)
    together = threading.Barrier(3, timeout=20)
    parallel_for(lambda begin, end: end and together.wait(), 3, 1)


def test_small_loops_stay_on_the_calling_thread():
    set_thread_count(4)
    names = []
    parallel_for(lambda begin, end: names.append(threading.current_thread()), 10, 10)
    assert names == [threading.current_thread()]


def test_what_the_body_calls_is_compiled_on_the_calling_thread_first():
    """An interrupt during a compilation on another thread could leave a lock held."""
    set_thread_count(3)
    first = []
    parallel_for(lambda begin, end: first.append((end, threading.current_thread())), 9, 1)
    assert first[0] == (0, threading.current_thread())


def helper_processors():
    """The processors that each helping thread of a loop may use."""
    found = {}
    together = threading.Barrier(thread_count(), timeout=20)

    def body(begin, end):
        if end:
            together.wait()
            found[threading.get_native_id()] = os.sched_getaffinity(0)

    parallel_for(body, thread_count(), 1)
    del found[threading.get_native_id()]
    return list(found.values())


@pytest.mark.skipif(processors.current_processor is None, reason="threads cannot be bound here")
def test_helping_threads_keep_off_the_processor_of_their_caller(monkeypatch):
    allowed = os.sched_getaffinity(0)
    if len(allowed) < 2:
        pytest.skip("needs two processors")
    set_thread_count(3)
    helper_processors()  # starts them
    for here in sorted(allowed)[:2]:
        monkeypatch.setattr(processors, "current_processor", lambda here=here: here)
        assert helper_processors() == [allowed - {here}] * 2
    assert os.sched_getaffinity(0) == allowed
    # A caller that may use one processor only: the others stay where they are.
    try:
        os.sched_setaffinity(0, {here})
        assert helper_processors() == [allowed - {here}] * 2
    finally:
        os.sched_setaffinity(0, allowed)
    monkeypatch.setattr(processors, "current_processor", None)
    assert len(helper_processors()) == 2


@pytest.mark.parametrize("count", [1, 4])
def test_an_error_stops_the_loop_and_is_raised(count):
    set_thread_count(count)
    calls = []

    def body(begin, end):
        calls.append(begin)
        if begin == 5:
            raise ArithmeticError("five")
        time.sleep(0.001)

    with pytest.raises(ArithmeticError, match="five"):
        parallel_for(body, 100_000, 1)
    assert len(calls) < 1000


@pytest.mark.parametrize("where", ["in the calling thread", "in a pool thread"])
def test_a_loop_inside_stops_with_the_loop_around_it(where):
    """Otherwise an interrupted image would trace its other bands to the end."""
    set_thread_count(2)
    calling = threading.current_thread()
    inside = threading.Event()
    done = []

    def body(begin, end):
        if end and (threading.current_thread() is calling) == (where == "in the calling thread"):
            inside.wait(20)
            raise ArithmeticError("stop")
        if end:
            parallel_for(long_body, 10_000, 1)

    def long_body(begin, end):
        inside.set()
        done.append(begin)
        time.sleep(0.002)

    started = time.perf_counter()
    with pytest.raises(ArithmeticError):
        parallel_for(body, 2, 1)
    assert time.perf_counter() - started < 10
    assert len(done) < 5000


def test_progress_comes_from_the_calling_thread_and_ends_at_the_whole():
    set_thread_count(2)
    seen = []

    def progress(done, total):
        assert threading.current_thread() is threading.main_thread()
        seen.append(done)

    parallel_for(lambda begin, end: time.sleep(0.01), 60, 1, progress)
    assert len(seen) >= 3
    assert seen == sorted(seen)
    assert seen[-1] == 60


def test_the_environment_chooses(monkeypatch):
    monkeypatch.setenv("RAYSTREAM_THREADS", "3")
    assert thread_count() == 3
    set_thread_count(5)
    assert thread_count() == 5
    set_thread_count(None)
    monkeypatch.delenv("RAYSTREAM_THREADS")
    assert thread_count() >= 1


@pytest.mark.parametrize("text", ["0", "-2", "two", "1.5"])
def test_a_bad_choice_is_named(monkeypatch, text):
    monkeypatch.setenv("RAYSTREAM_THREADS", text)
    with pytest.raises(ValueError, match="RAYSTREAM_THREADS"):
        thread_count()
    with pytest.raises(ValueError, match="threads"):
        set_thread_count(0)
    with pytest.raises(TypeError):
        set_thread_count(2.5)


def test_a_small_loop_does_not_wait_for_others():
    """Its helpers may be queued behind a long loop of another thread."""
    set_thread_count(2)
    release = threading.Event()
    long_loop = threading.Thread(
        target=parallel_for, args=(lambda begin, end: end and release.wait(20), 4, 1)
    )
    long_loop.start()
    try:
        started = time.perf_counter()
        parallel_for(lambda begin, end: time.sleep(0.001), 8, 1)
        assert time.perf_counter() - started < 10
    finally:
        release.set()
        long_loop.join()


def test_the_number_of_threads_may_change_while_loops_run():
    set_thread_count(2)
    failures = []

    def query():
        try:
            for _ in range(200):
                parallel_for(lambda begin, end: None, 16, 1)
        except Exception as error:
            failures.append(error)

    threads = [threading.Thread(target=query) for _ in range(3)]
    for thread in threads:
        thread.start()
    for count in range(100):
        set_thread_count(1 + count % 4)
        time.sleep(0.001)
    for thread in threads:
        thread.join()
    assert not failures


INTERRUPTED = """
import os, signal, threading, time
import numpy as np
import raystream as rs

rng = np.random.default_rng(0)
scene = rs.Scene.from_arrays(rng.random((60_000, 3)), np.arange(60_000).reshape(-1, 3))
tracer = rs.Tracer(scene, "brute")
tracer.first_hit([0, 0, 0], [1, 1, 1])  # compiled by now
threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()
started = time.perf_counter()
try:
    tracer.first_hit(rng.random((400_000, 3)), rng.normal(size=(400_000, 3)))  # minutes
except KeyboardInterrupt:
    print("interrupted", time.perf_counter() - started)
print("still works", tracer.any_hit([0, 0, 0], [1, 1, 1]).shape)
"""


@pytest.mark.ci
def test_ctrl_c_ends_a_long_query():
    run = subprocess.run(
        [sys.executable, "-c", INTERRUPTED],
        capture_output=True,
        text=True,
        timeout=120,
        env=child_environment(RAYSTREAM_THREADS="2"),
        check=True,
    )
    word, seconds = run.stdout.split("\n")[0].split()
    assert word == "interrupted"
    assert float(seconds) < 10
    assert "still works" in run.stdout


FORKED = """
import os
from raystream.jit.threads import parallel_for, set_thread_count
set_thread_count(2)
parallel_for(lambda begin, end: None, 4, 1)
pid = os.fork()
done = []
parallel_for(lambda begin, end: done.extend(range(begin, end)), 4, 1)
assert sorted(done) == [0, 1, 2, 3]
if pid:
    assert os.waitpid(pid, 0)[1] == 0
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_forked_child_has_threads_of_its_own():
    set_thread_count(2)
    parallel_for(lambda begin, end: None, 4, 1)
    assert threads._pool is not None
    run = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", FORKED],
        timeout=60,
        env=child_environment(),
        check=False,
    )
    assert run.returncode == 0


@pytest.mark.usefixtures("two_threads")
def test_loops_in_a_loop_that_keeps_all_threads_busy_stay_on_their_threads():
    """Then, and only then: the last part's loops have both threads again."""
    used, both_inside = {}, threading.Barrier(2, timeout=10)

    def inner(part):
        def run(begin, end):
            if begin < end:
                used.setdefault(part, set()).add(threading.get_ident())
                time.sleep(0.02)

        return run

    def outer(begin, end):
        for part in range(begin, end):
            if part < 2:
                both_inside.wait()
            if part == 2:
                time.sleep(0.2)  # the other thread finds nothing left to do
            parallel_for(inner(part), 10, 1)

    parallel_for(outer, 3, 1)
    assert [len(used[part]) for part in range(3)] == [1, 1, 2]


@pytest.fixture
def two_threads():
    set_thread_count(2)
    yield
    set_thread_count(None)


@pytest.mark.usefixtures("two_threads")
@pytest.mark.parametrize(("joins_chunks", "most"), [(False, 2), (True, 32)])
def test_nested_loop_of_one_thread_joins_chunks_if_its_body_allows(joins_chunks, most):
    """Each call of a body may wait for the interpreter lock, which the other threads use."""
    calls = []

    def outer(begin, end):
        if begin < end:
            time.sleep(0.05)  # until both threads are busy
            mine = []

            def body(first, last):
                mine.append((first, last))

            parallel_for(body, 100, 2, joins_chunks=joins_chunks)
            calls.append(mine)

    parallel_for(outer, 2, 1)
    for mine in calls:
        assert sorted(i for first, last in mine for i in range(first, last)) == [*range(100)]
    assert max(last - first for mine in calls for first, last in mine) == most
