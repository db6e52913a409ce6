"""Kernels as fragment programs: a function in WGSL, and the streams that it reads and writes."""

from __future__ import annotations

from typing import NamedTuple


class FragmentKernel(NamedTuple):
    """A fragment program, declared like a `streams.Kernel`.

    Attributes
    ----------
    name : str
    entry : str
        Its entry point in WGSL, which returns a texel of each stream. It has no ``discard``, so
        that the stencil test comes first.
    state : int
        It runs on the records in this state.
    next_states : tuple of int
        The states that it may set, with its own if records may stay in it.
    reads, writes : tuple of str
        Names of streams.
    """

    name: str
    entry: str
    state: int
    next_states: tuple[int, ...]
    reads: tuple[str, ...]
    writes: tuple[str, ...]

    @property
    def transitions(self) -> tuple[int, ...]:
        """States that it moves records to."""
        return tuple(state for state in self.next_states if state != self.state)
