"""Machine code of kernels for arguments of known types."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import kernel
from raystream.jit.entries import entry_of


class _Scale(NamedTuple):
    factor: float
    offset: int | None


@kernel
def _scaled(begin, end, scale):
    return (end - begin) * scale.factor


def test_entry_gives_what_the_kernel_gives():
    entry = entry_of(_scaled, (0, 1, _Scale(2.0, 3)))
    assert entry(2, 7, _Scale(0.5, -1)) == 2.5 == _scaled(2, 7, _Scale(0.5, -1))


def test_entries_differ_by_the_types_of_members():
    entries = [
        entry_of(_scaled, (0, 1, _Scale(f, i))) for f in (1.0, np.float32(1)) for i in (1, None)
    ]
    assert len(set(map(id, entries))) == 4
    assert entry_of(_scaled, (5, 6, _Scale(7.0, 8))) is entries[0]


def test_other_functions_are_their_own_entries():
    assert entry_of(max, (1, 2)) is max
