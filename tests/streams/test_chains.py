import numpy as np
import pytest

from raystream.core.errors import LoopLimitError
from raystream.streams import Count, Counters, Kernel, Repeat, Sequential, Stream, While


def add_one(x):
    return x + 1


def add_below(x, limit):
    return x + 1 if x < limit else None


def make(stream, limit=None, name="K"):
    """A kernel that adds one: always, or to records below a limit."""
    if limit is None:
        return Kernel(add_one, inputs={"x": stream}, outputs=stream, name=name)
    return Kernel(
        add_below, inputs={"x": stream}, outputs=stream, constants={"limit": limit}, name=name
    )


@pytest.fixture
def stream():
    return Stream(np.array([0, 3, 5], np.int64))


def test_sequence(stream):
    """Figure 4.4, Listing 4.5."""
    count = Sequential(make(stream), make(stream, 5), make(stream)).run()
    assert (count.rounds, count.calls, count.written) == (1, 3, 3 + 2 + 3)
    assert count.steps == (Count(1, 1, 3), Count(1, 1, 2), Count(1, 1, 3))
    assert stream.array.tolist() == [3, 6, 7]


def test_for_loop(stream):
    """Figure 4.5, Listing 4.6."""
    count = Sequential(Repeat(15, make(stream)), make(stream)).run()
    assert count.calls == 16
    assert count.steps[0] == Count(15, 15, 45, (Count(15, 15, 45),))
    assert stream.array.tolist() == [16, 19, 21]
    assert Repeat(0, make(stream)).run() == Count(0, 0, 0)


def test_while_over_one_kernel(stream):
    """Figure 4.6, Listing 4.7: the same as `loop`."""
    same = Stream(stream.array)
    count = While(make(stream, 5)).run()
    assert count == Count(6, 6, 5 + 2, (Count(6, 6, 7),))
    assert make(same, 5).loop() == 6
    assert stream.array.tolist() == same.array.tolist() == [5, 5, 5]


def test_while_over_several_kernels(stream):
    """Figure 4.7, Listing 4.8: the last kernel ends it."""
    steps = Stream(np.array([0, 0, 0], np.int64))
    first, last = make(steps), make(stream, 5)
    count = While(first, last).run()
    assert count.rounds == 6
    assert count.calls == 12
    assert [step.written for step in count.steps] == [18, 7]
    assert steps.array.tolist() == [6, 6, 6]

    # By hand, as in the listing.
    again, n, rounds = Stream(np.array([0, 3, 5], np.int64)), 0, 0
    last = make(again, 5)
    while n != 1:
        n = 0
        first.execute()
        rounds += 1
        if last.execute() == 0:
            n += 1
    assert rounds == count.rounds


def up(x, other, limit):
    """Climbs to a limit, but no further than one above the other."""
    return x + 1 if x < limit and x <= other else None


def climbers():
    a, b = (Stream(np.zeros(4, np.int64)) for _ in range(2))
    limit = Stream(np.array([1, 2, 5, 9]))
    return [
        Kernel(up, inputs={"x": x, "other": other, "limit": limit}, outputs=x)
        for x, other in ((a, b), (b, a))
    ], (a, b)


def test_nested_while_loops():
    """Figure 4.9, Listing 4.9: until neither loop finds anything to do."""
    (first, second), (a, b) = climbers()
    count = While(While(first), While(second), idle="all").run()

    (one, two), (c, d) = climbers()
    n, rounds, calls = 0, 0, 0
    while n != 2:
        n = 0
        for kernel in (one, two):
            done = kernel.loop()
            calls += done
            n += done == 1
        rounds += 1
    assert (count.rounds, count.calls) == (rounds, calls)
    assert a.array.tolist() == c.array.tolist() == [1, 2, 5, 9]
    assert b.array.tolist() == d.array.tolist() == [1, 2, 5, 9]
    assert count.written == 2 * (1 + 2 + 5 + 9)
    assert sum(step.rounds for step in count.steps) == calls


def test_passes_add_up(stream):
    counters = Counters()
    chain = Sequential(
        Repeat(3, make(stream, name="A")), While(make(stream, 20, "B"), make(stream, 30, "C"))
    )
    count = chain.run(counters)
    assert counters.pass_count == count.calls
    assert counters.written_count == count.written
    assert counters.of("A").pass_count == 3
    assert counters.of("C").written_count == count.steps[1].steps[1].written


def test_a_chain_that_does_not_end_is_an_error(stream):
    with pytest.raises(LoopLimitError, match=r"While\(K\): still wrote 3 records in round 7"):
        While(make(stream), limit=7).run()
    with pytest.raises(LoopLimitError):
        While(While(make(stream), limit=3), idle="all").run()


def test_a_step_of_ones_own(stream):
    class Print:
        def run(self, counters=None):  # noqa: ARG002
            seen.append(stream.sum())
            return Count(1, 0, 0)

    seen = []
    Repeat(2, Print(), make(stream)).run()
    assert seen == [8, 11]


def test_wrong_chains_are_said(stream):
    kernel = make(stream)
    with pytest.raises(ValueError, match="at least one step"):
        Sequential()
    with pytest.raises(TypeError, match="is not a step"):
        Sequential(kernel.execute)
    with pytest.raises(ValueError, match="number of times"):
        Repeat(-1, kernel)
    with pytest.raises(ValueError, match="idle"):
        While(kernel, idle="first")
    with pytest.raises(ValueError, match="limit"):
        While(kernel, limit=0)
    assert repr(While(Repeat(2, kernel), kernel)) == "While(Repeat(K), K)"
