"""Mailboxes: repeated tests of a ray."""

from __future__ import annotations

import pytest

from extras import need

need("raystream_lab")

from lab.walking import walks_of
from raystream_lab.walks import repeated_tests


def triangles_of(walks, ray):
    """The triangles that a ray tests, one after another."""
    lists = walks.structure.lists
    cells = iter(walks.visits_of(ray).tolist())
    for kernel, length in walks.runs_of(ray):
        if kernel == "traverse":
            for _ in range(length):
                cell = next(cells)
        if kernel == "intersect":
            first = int(lists.splits[cell])
            yield from lists.references[first : first + length].tolist()


@pytest.mark.parametrize("any_hit", [False, True])
def test_mailboxes_are_counted_as_a_dictionary_counts_them(any_hit):
    walks = walks_of("grid", any_hit)
    sizes = (1, 4, 16, 64)
    test_count = repeat_count = 0
    saved = dict.fromkeys(sizes, 0)
    for ray in range(len(walks)):
        seen, boxes = set(), {size: {} for size in sizes}
        for prim_id in triangles_of(walks, ray):
            test_count += 1
            repeat_count += prim_id in seen
            seen.add(prim_id)
            for size, box in boxes.items():
                saved[size] += box.get(prim_id % size) == prim_id
                box[prim_id % size] = prim_id
    found = repeated_tests(walks)
    assert found.tests == test_count == walks.counters.total["tests"]
    assert found.repeats == repeat_count > 0
    assert dict(found.saved) == saved
    assert saved[4] < saved[64] <= repeat_count


def test_a_large_mailbox_saves_every_repeat():
    walks = walks_of("grid")
    found = repeated_tests(walks, entries=[1 << 12])
    assert len(walks.structure.triangles) <= 1 << 12
    assert found.saved[1 << 12] == found.repeats


@pytest.mark.parametrize("size", [0, 3, -4, 1 << 21])
def test_sizes_are_powers_of_two(size):
    with pytest.raises(ValueError, match="entries: expected powers of two"):
        repeated_tests(walks_of("grid"), entries=[size])


def test_other_walks_are_refused():
    with pytest.raises(ValueError, match="a grid, got kdtree"):
        repeated_tests(walks_of("kdtree, stack"))
