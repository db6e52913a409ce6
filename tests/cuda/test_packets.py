"""Packet traversal in an emulated warp: threads that wait for each other at votes."""

from __future__ import annotations

import ctypes
import threading
from types import FunctionType, SimpleNamespace

import numba
import numpy as np
import pytest

from extras import need

need("numba_cuda")

import raystream as rs
from raystream.core.rays import RayBatch
from raystream.cuda import query_kernels
from raystream.cuda.bvh import packet_traversal
from raystream.cuda.bvh.binary import STACK_BYTES
from raystream.cuda.bvh.kernels import lay_out
from raystream.cuda.structures import kernels_of
from raystream.jit.cpu import FLAGS, device
from raystream.jit.simd import load, store
from raystream.jit.warp import active_mask, ballot
from raystream.kernels.hits import HitAddresses, HitArrays
from raystream.kernels.ray_source import RaySource, ResultAddresses
from raystream.kernels.tally import new_tallies
from raystream.structures import build_structure
from test_agreement import case_of

#: Threads of the emulated warp.
LANES = 6
RAYS = 2 * LANES

#: Seconds after which a vote that a thread does not come to has failed; they include compiling.
PATIENCE = 100.0


class Warp:
    """Threads that vote.

    Attributes
    ----------
    vote_count : int
        How many votes there were.
    """

    def __init__(self):
        self._barrier = threading.Barrier(LANES)
        self._lanes, self._said = {}, [0] * LANES
        self.vote_count = 0

    def vote(self, says_yes):
        """Cast a thread's vote; returns the mask of all votes."""
        lane = self._lanes[threading.get_ident()]
        self._said[lane] = says_yes
        try:
            self._barrier.wait(PATIENCE)
            answer = sum(one << number for number, one in enumerate(self._said))
            self.vote_count += lane == 0
            self._barrier.wait(PATIENCE)
        except threading.BrokenBarrierError:
            return 0
        return answer

    def run(self, function, first, arguments):
        """Call a kernel's function for all lanes of the warp concurrently."""
        failed = []

        def one(lane):
            self._lanes[threading.get_ident()] = lane
            try:
                function(np.uint64(first + lane), *arguments)
            except BaseException as error:
                failed.append(error)
                self._barrier.abort()

        lanes = [threading.Thread(target=one, args=(lane,)) for lane in range(LANES)]
        for one_lane in lanes:
            one_lane.start()
        for one_lane in lanes:
            one_lane.join()
        if failed:
            raise failed[0]
        assert not self._barrier.broken, "a thread left the others waiting"


@pytest.fixture(scope="module")
def emulated():
    """The packet kernels, with votes among threads, and their warp."""
    warp = Warp()
    callback = ctypes.CFUNCTYPE(ctypes.c_uint32, ctypes.c_uint32)(warp.vote)

    @numba.njit(**FLAGS)
    def vote(_voters, says_yes):
        return np.uint32(callback(np.uint32(says_yes)))

    @numba.njit(**FLAGS)
    def everyone():
        return np.uint32((1 << LANES) - 1)

    names = {**vars(packet_traversal), "ballot": vote, "active_mask": everyone}
    for name in ("_visit", "traverse"):
        code = getattr(packet_traversal, name).py_func.__code__
        names[name] = device(FunctionType(code, names, f"emulated_{name}"))
    with pytest.MonkeyPatch.context() as patch:  # nothing of it is kept on disk
        patch.setattr(query_kernels, "kernel", numba.njit(**FLAGS))
        queries = query_kernels.make_kernels(names["traverse"], STACK_BYTES)
    return SimpleNamespace(queries=queries, warp=warp, callback=callback)


@pytest.fixture(scope="module")
def rays():
    """Half of them share an origin, half are random."""
    return rays_of(slice(None))


def rays_of(rows):
    case = case_of("random_soup")
    rows = np.arange(len(case.origins))[rows]
    rows = rows[np.linspace(0, len(rows) - 1, RAYS).astype(int)]
    origins, directions = case.origins[rows].copy(), case.directions[rows].copy()
    origins[:LANES] = origins[0]
    directions[:LANES] = directions[0] + np.linspace(0.0, 0.02, LANES)[:, None]
    return RayBatch(origins, directions, 0.0, np.inf)


@pytest.fixture(scope="module")
def structure():
    triangles = case_of("random_soup").scene.triangles
    return build_structure("bvh", triangles, max_leaf_size=2)


def address(array):
    return np.uint64(array.ctypes.data)


def shared_by(structure, rays):
    """Arguments common to all kernels, the rays' tallies, and objects to keep alive."""
    laid_out = lay_out(structure, "packet")
    source, kept = RaySource.of(rays.origins, rays.directions, rays.limits)
    tallies = new_tallies(len(rays))
    return (source, structure.frame, laid_out.tree, address(tallies)), tallies, (kept, laid_out)


def run(emulated, query, arguments):
    for first in range(0, RAYS, LANES):
        emulated.warp.run(getattr(emulated.queries, query).function, first, arguments)


def test_first_hits_of_a_warp(emulated, structure, rays):
    shared, tallies, _kept = shared_by(structure, rays)
    hits, status = HitArrays.empty(RAYS), np.zeros(RAYS, np.uint8)
    to = ResultAddresses(*map(address, hits), np.uint64(0), address(status))
    before = emulated.warp.vote_count
    run(emulated, "first_hit", (*shared, to))
    oracle = rs.Tracer(case_of("random_soup").scene, "brute")
    expected = oracle.first_hit(rays.origins, rays.directions)
    for column in ("t", "u", "v", "prim_id"):
        assert getattr(hits, column).tobytes() == getattr(expected, column).tobytes()
    # All go the same way, and it is a way for each of them.
    steps, leaves = (tallies[:, k].reshape(2, LANES) for k in (0, 1))
    assert (steps == steps[:, :1]).all()
    assert (leaves == leaves[:, :1]).all()
    alone = new_tallies(RAYS)
    lonely = kernels_of("bvh", "binary").first_hit.function
    for i in map(np.uint64, range(RAYS)):
        lonely(i, *shared[:3], address(alone), to)
    own = alone[:, 0].reshape(2, LANES)
    assert (steps[:, 0] < own.sum(axis=1)).all()
    assert steps[0, 0] < steps[1, 0]  # rays that are alike share more of them
    # Two votes for a node that no ray enters, three for others, and one for a leaf.
    votes = emulated.warp.vote_count - before
    least, most = 2 * steps[:, 0] + leaves[:, 0], 3 * steps[:, 0] + leaves[:, 0]
    assert least.sum() < votes < most.sum()


def test_whether_a_warp_s_rays_hit_anything(emulated, structure, rays):
    """A ray that has found a hit waits for the others, and ends with the last."""
    shared, tallies, _kept = shared_by(structure, rays)
    seen, status = np.zeros(RAYS, np.bool_), np.zeros(RAYS, np.uint8)
    nowhere = np.uint64(0)
    to = ResultAddresses(*[nowhere] * 4, address(seen), address(status))
    run(emulated, "any_hit", (*shared, to))
    oracle = rs.Tracer(case_of("random_soup").scene, "brute")
    assert seen.tolist() == oracle.any_hit(rays.origins, rays.directions).tolist()
    assert np.count_nonzero(seen) > 0
    tests = tallies[:, 2]
    assert len(set(tests.tolist())) > 1  # not all tested as many triangles


@pytest.mark.exhaustive
def test_all_hits_of_a_warp(emulated, structure):
    # Of rays without a hit, none comes to the votes on where hits are written.
    case = case_of("random_soup")
    oracle = rs.Tracer(case.scene, "brute")
    rays = rays_of(oracle.any_hit(case.origins, case.directions))
    shared, _tallies, _kept = shared_by(structure, rays)
    counts, status = np.zeros(RAYS, np.int64), np.zeros(RAYS, np.uint8)
    to_counts = query_kernels.CountAddresses(address(status), address(counts))
    more = False, np.uint64(2**32), to_counts
    run(emulated, "count_hits", (*shared, *more))
    expected = oracle.multi_hit(rays.origins, rays.directions)
    assert np.array_equal(counts, expected.counts)
    splits = expected.ray_splits.astype(np.int64)
    hits, found = HitArrays.empty(int(splits[-1])), np.zeros(RAYS, np.int64)
    assert (np.diff(splits) > 0).all()
    rows = address(splits), HitAddresses(*map(address, hits)), address(found)
    more = False, query_kernels.RowAddresses(*rows)
    run(emulated, "multi_hit", (*shared, *more))
    for column in ("t", "u", "v", "prim_id"):
        assert getattr(hits, column).tobytes() == getattr(expected, column).tobytes()


@numba.njit(**FLAGS)
def _vote_alone(to):
    voters = active_mask()
    store(to, voters)
    store(to + np.uint64(4), ballot(voters, load(np.uint32, to) == np.uint32(1)))
    store(to + np.uint64(8), ballot(voters, load(np.uint32, to) == np.uint32(2)))


def test_a_thread_of_the_cpu_is_alone():
    said = np.full(3, 9, np.uint32)
    _vote_alone(address(said))
    assert said.tolist() == [1, 1, 0]
