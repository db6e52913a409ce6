"""Write the memory references of recorded walks, ray by ray or pass by pass."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.constants import SHIFT_32
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import load, store

#: Roles of kernels, which decide what they read.
NOTHING, STEP, TEST, SHADE = (np.uint8(k) for k in range(4))

#: Maximum references per step.
STEP_ROOM = 8

#: The kernel of a finished ray.
DONE = np.uint8(255)

_GRID, _LISTS, _TRIANGLES, _SHADING, _STATE = (np.uint8(k) for k in range(5))
_ZERO, _ONE, _THREE, _FOUR, _SEVEN = (np.uint64(k) for k in (0, 1, 3, 4, 7))
_LONG = np.uint64(3)
_RGB = np.uint64(12)
_RGBA = np.uint64(4)  # log2 of 16 bytes
_NO_HIT = np.int32(-1)


class FetchTables(NamedTuple):
    """The inputs of references: addresses of arrays, and of textures in texture memory.

    Attributes
    ----------
    run_splits, run_kernels, run_lengths, visit_splits, visits, prim_ids : uint64
        See `Walks`.
    splits, references, entries : uint64
        See `GridArrays` and `Textures`.
    roles : uint64
        The role of each kernel, uint8.
    grid, lists, corners, corner_pitch, shading, shading_pitch, state, state_pitch : uint64
        The first texture of each kind, and the distance to the next one.
    """

    run_splits: np.uint64
    run_kernels: np.uint64
    run_lengths: np.uint64
    visit_splits: np.uint64
    visits: np.uint64
    prim_ids: np.uint64
    splits: np.uint64
    references: np.uint64
    entries: np.uint64
    roles: np.uint64
    grid: np.uint64
    lists: np.uint64
    corners: np.uint64
    corner_pitch: np.uint64
    shading: np.uint64
    shading_pitch: np.uint64
    state: np.uint64
    state_pitch: np.uint64


class OutAddresses(NamedTuple):
    """Output addresses of references: uint64, uint8 and uint8."""

    addresses: np.uint64
    kinds: np.uint64
    words: np.uint64


class PassPlan(NamedTuple):
    """The P passes of a schedule of K kernels, and what each kernel does in a pass.

    Attributes
    ----------
    kernels : ndarray of shape (P,), uint8
        The kernel of each pass.
    run_counts : ndarray of shape (P,), uint32
        The number of rays that each ran on.
    at_once : ndarray of shape (K,), uint32
        Maximum steps of each kernel per pass.
    state_words : ndarray of shape (K,), uint8
        Words of state that each kernel reads per ray.
    """

    kernels: NDArray[np.uint8]
    run_counts: NDArray[np.uint32]
    at_once: NDArray[np.uint32]
    state_words: NDArray[np.uint8]


class RayProgress(NamedTuple):
    """The position of N rays in a schedule.

    Attributes
    ----------
    kernels : ndarray of shape (N,), uint8
        The kernel that each ray waits for, or `DONE`.
    runs : ndarray of shape (N,), uint64
        The row of its run.
    done : ndarray of shape (N,), uint32
        Finished steps of that run.
    visits : ndarray of shape (N,), uint64
        The row of the next cell.
    """

    kernels: NDArray[np.uint8]
    runs: NDArray[np.uint64]
    done: NDArray[np.uint32]
    visits: NDArray[np.uint64]


@device
def _put(out, at, address, kind, words):
    """Write a reference; returns the index of the next one."""
    store(out.addresses + (at << _LONG), address)
    store(out.kinds + at, kind)
    store(out.words + at, np.uint8(words))
    return at + _ONE


@device
def _long(array, row):
    return np.uint64(load(np.int64, array + (row << _LONG)))


@device
def _word(array, row):
    return np.uint64(load(np.uint32, array + (row << SHIFT_32)))


@device
def _kernel_of(tables, run):
    """The kernel of a run."""
    return np.uint64(load(np.uint8, tables.run_kernels + run))


@device
def _fetch(tables, out, at, role, ray, visit, done):
    """Write the references of one step of a ray, after `visit` cells and `done` steps of its run.

    Returns the index of the next reference, and the number of cells visited.
    """
    if role == STEP:
        address = tables.grid + (_word(tables.visits, visit) << SHIFT_32)
        return _put(out, at, address, _GRID, _ONE), visit + _ONE
    if role == TEST:
        cell = _word(tables.visits, visit - _ONE)
        address = tables.lists + ((_word(tables.entries, cell) + done) << SHIFT_32)
        at = _put(out, at, address, _LISTS, _ONE)
        triangle = _word(tables.references, _word(tables.splits, cell) + done)
        address = tables.corners + triangle * _RGB
        for _ in range(_THREE):
            at = _put(out, at, address, _TRIANGLES, _THREE)
            address += tables.corner_pitch
    elif role == SHADE:
        prim_id = load(np.int32, tables.prim_ids + (ray << SHIFT_32))
        if prim_id != _NO_HIT:
            address = tables.shading + np.uint64(prim_id) * _RGB
            for _ in range(_SEVEN):
                at = _put(out, at, address, _SHADING, _THREE)
                address += tables.shading_pitch
    return at, visit


@kernel
def fetch_branching(order, tables, cursor, out, room):
    """Write references ray by ray, until the output is full.

    Parameters
    ----------
    order : ndarray of shape (N,), uint32
    tables : FetchTables
    cursor : ndarray of shape (4,), uint64
        Number of finished rays; and of the next one, its run (`2**64 - 1` if not started), the
        finished steps of the run, and the row of its next cell. Updated.
    out : OutAddresses
    room : int
        Capacity of `out` in references.

    Returns
    -------
    int
        Number of references written.
    """
    at, last = _ZERO, np.uint64(room) - np.uint64(STEP_ROOM)
    place, run, done, visit = cursor[0], cursor[1], cursor[2], cursor[3]
    while place < np.uint64(len(order)):
        ray = np.uint64(order[place])
        if run == np.uint64(2**64 - 1):
            run, done = _long(tables.run_splits, ray), _ZERO
            visit = _long(tables.visit_splits, ray)
        end = _long(tables.run_splits, ray + _ONE)
        while run < end and at <= last:
            role = load(np.uint8, tables.roles + _kernel_of(tables, run))
            length = _word(tables.run_lengths, run)
            while done < length and at <= last:
                at, visit = _fetch(tables, out, at, role, ray, visit, done)
                done += _ONE
            if done == length:
                run, done = run + _ONE, _ZERO
        if run < end:
            break
        place, run = place + _ONE, np.uint64(2**64 - 1)
    cursor[0], cursor[1], cursor[2], cursor[3] = place, run, done, visit
    return np.int64(at)


@kernel
def begin_rays(tables, rays):
    """Start all rays at their first runs; see `fetch_multipass`."""
    for ray in range(np.uint64(len(rays.kernels))):
        run = _long(tables.run_splits, ray)
        rays.runs[ray], rays.done[ray] = run, 0
        rays.visits[ray] = _long(tables.visit_splits, ray)
        is_over = run == _long(tables.run_splits, ray + _ONE)
        rays.kernels[ray] = DONE if is_over else np.uint8(_kernel_of(tables, run))


@kernel
def fetch_multipass(order, tables, plan, rays, cursor, out, room):
    """Write references pass by pass, until the output is full.

    Parameters
    ----------
    order, tables, out, room
        See `fetch_branching`.
    plan : PassPlan
    rays : RayProgress
        Updated.
    cursor : ndarray of shape (3,), uint64
        Finished passes; rays visited in the next pass, and the number of them that it ran on.
        Updated.

    Returns
    -------
    int
        Number of references written; -1 if a pass ran on another number of rays than planned.
    """
    at = _ZERO
    passes, counts, at_once, words = plan
    number, place, ran = cursor[0], cursor[1], cursor[2]
    while number < np.uint64(len(passes)):
        kernel_number = np.uint64(passes[number])
        role = load(np.uint8, tables.roles + kernel_number)
        state_words, most = np.uint64(words[kernel_number]), np.uint64(at_once[kernel_number])
        last = np.uint64(room) - (np.uint64(STEP_ROOM) * most + np.uint64(STEP_ROOM))
        while place < np.uint64(len(order)) and at <= last:
            ray = np.uint64(order[place])
            place += _ONE
            if np.uint64(rays.kernels[ray]) != kernel_number:
                continue
            ran += _ONE
            # Step 1: its state, four words per texel.
            address, left = tables.state + (ray << _RGBA), state_words
            while left != _ZERO:
                read = min(left, _FOUR)
                at = _put(out, at, address, _STATE, read)
                address += tables.state_pitch
                left -= read
            # Step 2: the reads of its steps.
            run, done, visit = rays.runs[ray], np.uint64(rays.done[ray]), rays.visits[ray]
            length = _word(tables.run_lengths, run)
            for _ in range(min(most, length - done)):
                at, visit = _fetch(tables, out, at, role, ray, visit, done)
                done += _ONE
            rays.visits[ray] = visit
            # Step 3: the kernel that it waits for next.
            if done == length:
                run, done = run + _ONE, _ZERO
                rays.runs[ray] = run
                is_over = run == _long(tables.run_splits, ray + _ONE)
                rays.kernels[ray] = DONE if is_over else np.uint8(_kernel_of(tables, run))
            rays.done[ray] = np.uint32(done)
        if place < np.uint64(len(order)):
            break
        if ran != np.uint64(counts[number]):
            return -1
        number, place, ran = number + _ONE, _ZERO, _ZERO
    cursor[0], cursor[1], cursor[2] = number, place, ran
    return np.int64(at)
