"""The cache simulator against plain Python, and cases counted by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from extras import need

need("raystream_lab")

from cache_oracles import direct_misses, lines_of, lru_misses, stack_distances
from raystream_lab.caches import Cache, LineCounts, ReuseDistances

KINDS = ("cells", "lists", "vertices")

LINE_SIZES = st.sampled_from([4, 5, 12, 16, 48, 64, 100])


class ShortLists(Cache):
    """Has a hash table where others have lists."""

    _longest_list = 1


class Cramped(ReuseDistances):
    """Runs out of room all the time."""

    _first_capacity = 8
    _first_end = 64
    _times_per_line = 1


class Roomy(ReuseDistances):
    """Has a time line of several rows of blocks from the start."""

    _first_end = 1 << 20


@st.composite
def traces(draw, most_lines: int = 60, most: int = 250):
    """References (address, length, kind), near each other and far, in a few places."""
    step = draw(st.sampled_from([1, 4, 12, 48, 64 * 1365]))
    base = draw(st.sampled_from([0, 0, 1 << 20, (1 << 64) - 255 - most_lines * 64 * 1365]))
    addresses = draw(st.lists(st.integers(0, most_lines - 1), max_size=most))
    if draw(st.booleans()):
        lengths = [draw(st.integers(1, 255))] * len(addresses)
    else:
        sizes = st.sampled_from([1, 4, 12, 16, 17, 255])
        lengths = draw(st.lists(sizes, min_size=len(addresses), max_size=len(addresses)))
    each = st.integers(0, len(KINDS) - 1)
    kinds = draw(st.lists(each, min_size=len(addresses), max_size=len(addresses)))
    return list(zip([base + step * address for address in addresses], lengths, kinds, strict=True))


def feed(simulator, references, chunk: int = 10**9) -> None:
    """Give a trace to a simulator in chunks."""
    for begin in range(0, len(references), chunk):
        rows = references[begin : begin + chunk]
        addresses, lengths, kinds = (list(column) for column in zip(*rows, strict=True))
        simulator.access(
            np.array(addresses, np.uint64), np.array(kinds, np.uint8), np.array(lengths, np.uint8)
        )


def misses_of(counts) -> list[int]:
    return [one.misses for one in counts.values()]


def assert_same_accesses(counts, references, line_size) -> None:
    accesses = list(lines_of(references, line_size))
    for kind, one in enumerate(counts.values()):
        lengths = [length for _, length, its in references if its == kind]
        assert one.references == len(lengths)
        assert one.bytes_requested == sum(lengths)
        assert one.accesses == sum(its == kind for _, its in accesses)


@settings(max_examples=150)
@given(traces(), LINE_SIZES, st.integers(1, 70), st.integers(0, 99), st.data())
def test_misses_are_those_of_plain_python(references, line_size, line_count, more, data):
    size = line_count * line_size + more % line_size
    ways = data.draw(st.one_of(st.none(), st.integers(1, line_count)))
    expected = lru_misses(references, size, line_size, ways)
    if ways == 1:
        assert expected == direct_misses(references, size, line_size)
    chunk = data.draw(st.integers(1, 300))
    for kind_of_cache in (Cache, ShortLists):
        cache = kind_of_cache(size, line_size, ways, kinds=KINDS)
        feed(cache, references, chunk)
        assert misses_of(cache.counts) == [expected[kind] for kind in range(len(KINDS))]
        assert_same_accesses(cache.counts, references, line_size)


@settings(max_examples=100)
@given(traces(), LINE_SIZES, st.integers(1, 300), st.sampled_from([ReuseDistances, Cramped]))
def test_distances_are_those_of_plain_python(references, line_size, chunk, measure):
    expected, first = stack_distances(references, line_size)
    distances = measure(line_size, kinds=KINDS)
    feed(distances, references, chunk)
    histogram = distances.histogram()
    found = {
        (int(kind), int(distance)): int(histogram[kind, distance])
        for kind, distance in zip(*np.nonzero(histogram), strict=True)
    }
    assert found == expected
    assert misses_of(distances.counts(0)) == [one.accesses for one in distances.counts(0).values()]
    assert misses_of(distances.counts(10**30)) == [first[kind] for kind in range(len(KINDS))]
    assert distances.line_count == sum(first.values())
    assert_same_accesses(distances.counts(0), references, line_size)


@settings(max_examples=40)
@given(traces(), LINE_SIZES)
def test_curve_is_that_of_fully_associative_caches(references, line_size):
    distances = Cramped(line_size, kinds=KINDS)
    feed(distances, references)
    sizes = np.arange(1, distances.line_count + 3) * line_size + line_size // 2
    curve = distances.curve(sizes)
    for size, misses in zip(sizes, curve.misses, strict=True):
        cache = Cache(int(size), line_size, None, kinds=KINDS)
        feed(cache, references)
        assert misses_of(cache.counts) == misses.tolist()
    assert curve.misses.sum(axis=1).tolist() == distances.misses(sizes).tolist()


@pytest.mark.parametrize("measure", [ReuseDistances, Cramped, Roomy])
def test_long_trace_of_many_lines(measure, rng):
    # Far apart in time and space: the distances reach over words, blocks and rows.
    count = 400_000
    near = np.abs(np.cumsum(rng.integers(-40, 41, count)))
    far = rng.integers(0, 1 << 40, 60_000)[rng.integers(0, 60_000, count)]
    lines = np.where(rng.random(count) < 0.3, far, near).astype(np.uint64)
    kinds = rng.integers(0, 2, count).astype(np.uint8)
    distances = measure(48, kinds=("near", "far"))
    for begin in range(0, count, 70_001):
        part = slice(begin, begin + 70_001)
        distances.access(lines[part] * np.uint64(48), kinds[part])
    assert distances.line_count == len(np.unique(lines))
    for line_count in (1, 33, 1000, 20_000, distances.line_count):
        cache = Cache(48 * line_count, 48, None, kinds=("near", "far"))
        cache.access(lines * np.uint64(48), kinds)
        assert cache.counts == distances.counts(48 * line_count)


def test_purcells_cache():
    cache = Cache(64 * 1024, 48)
    assert (cache.set_count, cache.ways, cache.unused_size) == (1365, 1, 16)
    # Three words of a vertex, four vertices to a line; then those that take the lines' places.
    vertices = np.arange(0, 1365 * 48, 12, dtype=np.uint64)
    cache.access(vertices, lengths=12)
    assert cache.total == LineCounts(5460, 5460, 1365, 65520, 48)
    assert cache.total.hit_rate == 0.75
    assert cache.total.traffic == 1.0
    cache.access(vertices + np.uint64(1365 * 48), lengths=12)
    assert cache.total.misses == 2730
    cache.access(vertices[-4:] + np.uint64(1365 * 48), lengths=12)
    assert cache.total.misses == 2730
    cache.clear()
    assert cache.total == LineCounts(0, 0, 0, 0, 48)
    assert np.isnan(cache.total.hit_rate)
    assert np.isnan(cache.total.traffic)


def test_reference_across_a_border_touches_both_lines():
    cache = Cache(480, 48, None)
    cache.access(np.array([40, 0, 48], np.uint64), lengths=16)
    assert cache.total == LineCounts(3, 4, 2, 48, 48)


def test_ways_that_do_not_divide_the_lines_leave_some_unused():
    cache = Cache(10 * 16 + 3, 16, 4)
    assert (cache.set_count, cache.unused_size) == (2, 2 * 16 + 3)
    assert "35 bytes unused" in repr(cache)


def test_curve_by_default_reaches_from_one_line_to_all():
    distances = ReuseDistances(32, kinds=("a", "b"))
    empty = distances.curve()
    assert empty.sizes.tolist() == [32]
    assert np.isnan(empty.hit_rates).all()
    lines = np.tile(np.arange(100, dtype=np.uint64), 3)
    distances.access(lines * np.uint64(32), 1)
    curve = distances.curve()
    assert curve.sizes[0] == 32
    assert curve.sizes[-2] < 100 * 32 <= curve.sizes[-1]
    assert curve.accesses.tolist() == [0, 300]
    assert curve.misses[-2].tolist() == [0, 300]  # round and round: all or nothing
    assert curve.misses[-1].tolist() == [0, 100]
    assert curve.hit_rates[-1] == pytest.approx(2 / 3)
    distances.clear()
    assert distances.line_count == 0
    assert distances.misses([32, 1 << 62]).tolist() == [0, 0]


def test_arrays_that_are_no_plain_blocks_of_memory():
    addresses = np.arange(0, 4000, 4, dtype=np.uint64)
    plain, strided = Cache(256, 16, 2, kinds=KINDS), Cache(256, 16, 2, kinds=KINDS)
    kinds = (np.arange(1000) % 3).astype(np.uint8)
    plain.access(addresses[::3].copy(), kinds[::3].copy())
    frozen = np.repeat(addresses[::3], 2)
    frozen.flags.writeable = False
    strided.access(frozen[::2], kinds[::3])
    assert plain.counts == strided.counts


WORD = np.zeros(1, np.uint64)

WRONG = {
    "size: must be at least 1, not -1": lambda: Cache(-1, 16),
    "size: must be an integer, not 1.5": lambda: Cache(1.5, 16),
    "line_size: must be at least 4, not 0": lambda: Cache(64, 0),
    "size: 64 bytes are less than a line of line_size=65": lambda: Cache(64, 65),
    "ways: 5 lines are more than the 4 of the cache": lambda: Cache(64, 16, 5),
    "ways: must be at least 1, not -1": lambda: Cache(64, 16, -1),
    "lines are more than": lambda: Cache(1 << 60, 16),
    "kinds: must be a sequence of names": lambda: Cache(64, 16, kinds="cells"),
    "kinds: must be 1 to 256 names, not 0": lambda: Cache(64, 16, kinds=()),
    "kinds: names must be unique": lambda: ReuseDistances(16, kinds=("a", "a")),
    "line_size: must be at least 4, not 3": lambda: ReuseDistances(3),
    "addresses: must be uint64, not int64": lambda: Cache(64, 16).access(WORD.astype(np.int64)),
    "addresses: must have shape": lambda: Cache(64, 16).access(WORD[None]),
    "kinds: must be an integer or uint8": lambda: Cache(64, 16).access(WORD, np.zeros(1)),
    "kinds: must have shape": lambda: Cache(64, 16).access(WORD, np.zeros(2, np.uint8)),
    "kinds: must be from 0 to 0, not 1": lambda: Cache(64, 16).access(WORD, np.ones(1, np.uint8)),
    "kinds: must be from 0 to 0, not 2": lambda: ReuseDistances(16).access(WORD, 2),
    "lengths: must be at least 1, not 0": lambda: Cache(64, 16).access(WORD, 0, 0),
    "lengths: must be from 1 to 255, not 0": lambda: Cache(64, 16).access(
        WORD, 0, np.zeros(1, np.uint8)
    ),
    "lengths: must be from 1 to 255, not 256": lambda: Cache(64, 16).access(WORD, 0, 256),
    "reference 0, 4 bytes at 18446744073709551613, extends beyond": lambda: Cache(64, 16).access(
        WORD - np.uint64(3)
    ),
    "sizes: must be integers": lambda: ReuseDistances(16).misses(0.5),
    "sizes: must not be negative": lambda: ReuseDistances(16).misses([-1]),
    "sizes: must have shape": lambda: ReuseDistances(16).curve([[1]]),
    "size: must be at least 0": lambda: ReuseDistances(16).counts(-1),
    "cannot add": lambda: LineCounts(0, 0, 0, 0, 16) + LineCounts(0, 0, 0, 0, 32),
}


@pytest.mark.parametrize("message", WRONG)
def test_bad_input_is_refused(message):
    with pytest.raises((TypeError, ValueError), match=message.replace("[", r"\[")):
        WRONG[message]()


def test_bad_chunk_changes_nothing():
    cache = Cache(64, 16, kinds=KINDS)
    with pytest.raises(ValueError, match="kinds"):
        cache.access(np.zeros(2, np.uint64), np.array([0, 3], np.uint8))
    assert cache.total.references == 0
    cache.access(np.array([(1 << 64) - 4, 0], np.uint64), 0, np.array([4, 255], np.uint8))
    assert cache.total.references == 2  # the long one is not at the end
