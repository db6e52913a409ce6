"""Memory references: addresses, number and order."""

from __future__ import annotations

from collections import deque

import numpy as np
import pytest

from extras import need

need("raystream_lab")

import raystream as rs
from lab.walking import walks_of
from raystream_lab.walks import (
    ALIGNMENT,
    Kind,
    StateWords,
    Textures,
    branching_references,
    multipass_references,
    ray_order,
    record,
    replay,
)


def joined(chunks):
    """All references of a trace: addresses, kinds, words."""
    return tuple(np.concatenate(parts) for parts in zip(*chunks, strict=True))


def steps_of(walks, layout, ray):
    """Reads of each step of a ray, derived in another way: (kernel, references)."""
    grid = walks.structure
    full = np.cumsum(np.diff(grid.lists.splits) > 0)  # the list's own null pointer is after it
    cells = iter(walks.visits_of(ray).tolist())
    for kernel, length in walks.runs_of(ray):
        for k in range(length):
            found = []
            if kernel == "traverse":
                cell = next(cells)
                found = [(layout.grid + 4 * cell, Kind.GRID, 1)]
            if kernel == "intersect":
                row = int(grid.lists.splits[cell]) + k
                prim_id = int(grid.lists.references[row])
                found = [(layout.lists + 4 * (row + int(full[cell]) - 1), Kind.LISTS, 1)]
                found += [(at + 12 * prim_id, Kind.TRIANGLES, 3) for at in layout.corners]
            if kernel == "shade" and walks.prim_ids[ray] >= 0:
                at_triangle = 12 * int(walks.prim_ids[ray])
                found = [(at + at_triangle, Kind.SHADING, 3) for at in layout.shading]
            yield kernel, found


def read_by_branching(walks, order):
    layout = Textures.of(walks.structure, len(walks))
    for ray in order:
        for _, found in steps_of(walks, layout, ray):
            yield from found


def read_by_multipass(walks, schedule, order, words):
    layout = Textures.of(walks.structure, len(walks), StateWords(*words.values()))
    left = {ray: deque(steps_of(walks, layout, ray)) for ray in order}
    for kernel, run_count in schedule:
        at_once = schedule.at_once[schedule.names.index(kernel)]
        runs = [ray for ray in order if left[ray] and left[ray][0][0] == kernel]
        assert len(runs) == run_count
        for ray in runs:
            for texel in range(-(-words[kernel] // 4)):
                count = min(4, words[kernel] - 4 * texel)
                yield layout.state[texel] + 16 * ray, Kind.STATE, count
            done = 0
            while left[ray] and left[ray][0][0] == kernel and done < at_once:
                yield from left[ray].popleft()[1]
                done += 1


def assert_same(chunks, expected):
    got = np.array(joined(chunks), np.uint64).T
    np.testing.assert_array_equal(got, np.array(list(expected), np.uint64))


@pytest.mark.parametrize("order", ["rows", "tiles", "morton"])
def test_branching_reads_all_of_a_ray_then_all_of_the_next(order):
    walks = walks_of("grid")
    chunks = list(branching_references(walks, order=order, chunk=1000))
    assert max(len(chunk.kinds) for chunk in chunks) <= 1000
    expected = read_by_branching(walks, ray_order(order, walks.shape).tolist())
    assert_same(chunks, expected)


@pytest.mark.parametrize(
    ("steps", "tests", "order", "chunk"),
    [(1, 1, "rows", 64), (4, 2, "morton", 1000), (10**9, 10**9, "rows", 1)],
)
def test_multipass_reads_pass_by_pass(steps, tests, order, chunk):
    walks = walks_of("grid")
    schedule = replay(walks, traversal_steps=steps, intersections=tests)
    words = {"set up": 11, "traverse": 14, "intersect": 14, "shade": 10}
    expected = read_by_multipass(walks, schedule, ray_order(order, walks.shape).tolist(), words)
    assert_same(multipass_references(walks, schedule, order=order, chunk=chunk), expected)


def test_any_hits_are_not_shaded():
    walks = walks_of("grid", any_hit=True)
    assert_same(branching_references(walks), read_by_branching(walks, range(len(walks))))


def test_both_machines_read_the_same_of_the_scene():
    """R v cells, R t entries and 3 R t corners, 21 words for each hit."""
    walks = walks_of("grid")
    words = StateWords(set_up=5, traverse=8, intersect=1, shade=0)
    schedule = replay(walks, scheduler="double")
    _, kinds, sizes = branching = joined(branching_references(walks))
    multipass = joined(multipass_references(walks, schedule, state_words=words))
    total = walks.counters.total
    v, t, s = total["steps"], total["tests"], total["shadings"]
    assert np.bincount(kinds).tolist() == [v, t, 3 * t, 7 * s]
    assert np.bincount(kinds, sizes).tolist() == [v, t, 9 * t, 21 * s]
    is_state = multipass[1] == Kind.STATE
    assert multipass[2][is_state].sum() == 5 * len(walks) + 8 * v + t
    of_scene = [column[~is_state] for column in multipass]
    for one, other in zip(branching, of_scene, strict=True):
        np.testing.assert_array_equal(np.sort(one), np.sort(other))


def test_textures_are_apart_and_aligned():
    walks = walks_of("grid")
    grid, triangle_count = walks.structure, len(walks.structure.triangles)
    layout = Textures.of(grid, len(walks), StateWords.of_purcell())
    assert len(layout.state) == 4
    ends = {
        layout.grid: 4 * grid.lattice.cell_count,
        layout.lists: 4
        * (len(grid.lists.references) + np.count_nonzero(np.diff(grid.lists.splits))),
        **dict.fromkeys(layout.corners + layout.shading, 12 * triangle_count),
        **dict.fromkeys(layout.state, 16 * len(walks)),
    }
    begins = sorted(ends)
    assert len(begins) == 2 + 3 + 7 + 4
    assert all(begin % ALIGNMENT == 0 for begin in begins)
    for begin, after in zip(begins, [*begins[1:], layout.byte_count], strict=True):
        assert begin + ends[begin] <= after < begin + ends[begin] + ALIGNMENT
    assert ALIGNMENT % 48 == ALIGNMENT % 4096 == 0


def test_orders():
    assert ray_order("rows", (2, 3)).tolist() == [0, 1, 2, 3, 4, 5]
    assert ray_order("rows", ()).tolist() == [0]
    assert ray_order("morton", (3, 4)).tolist() == [0, 1, 4, 5, 2, 3, 6, 7, 8, 9, 10, 11]
    tiles = ray_order("tiles", (10, 18)).tolist()
    assert sorted(tiles) == list(range(180))
    assert tiles[:9] == [0, 1, 2, 3, 4, 5, 6, 7, 18]
    assert tiles[64:66] == [8, 9]
    assert tiles[128:131] == [16, 17, 34]
    assert ray_order([2, 0, 1], (3,)).tolist() == [2, 0, 1]
    for wrong in ([0, 1], [0, 1, 1], [0.0, 1.0, 2.0]):
        with pytest.raises(ValueError, match="each of 3 rays once"):
            ray_order(wrong, (3,))
    with pytest.raises(ValueError, match="expected one of 'rows', 'tiles', 'morton'"):
        ray_order("random", (3, 3))
    with pytest.raises(ValueError, match="'tiles' needs rays of shape"):
        ray_order("tiles", (9,))


def test_what_cannot_be_read_is_refused():
    walks = walks_of("grid")
    with pytest.raises(ValueError, match="record with visits=True"):
        branching_references(walks_of("grid", visits=False))
    with pytest.raises(ValueError, match="a grid, got kdtree"):
        branching_references(walks_of("kdtree, stack"))
    with pytest.raises(ValueError, match="one level"):
        branching_references(walks_of("grid, two levels"))
    with pytest.raises(ValueError, match="belongs to other walks"):
        multipass_references(walks, replay(walks_of("kdtree, stack")))
    with pytest.raises(ValueError, match="belongs to other walks"):
        list(multipass_references(walks, replay(walks_of("grid", any_hit=True))))
    with pytest.raises(ValueError, match="state_words: expected 0 to 28"):
        multipass_references(
            walks, replay(walks), state_words=StateWords.of_purcell()._replace(traverse=29)
        )
    none = record(rs.Tracer(rs.Scene(), "grid"), [[0, 0, 0]], [[0, 0, 1]], visits=True)
    assert list(branching_references(none)) == []
