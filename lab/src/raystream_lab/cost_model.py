"""Cost model: instructions and bytes of an image from the counts of its rays (Purcell 2002, 3.2).

``C = R (C_r + v C_v + t C_t + s C_s) + R P C_stencil``: the cost of each kernel in Table 1 times
its number of runs. On the multipass architecture every pass reads the stencil of every ray.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from raystream_lab.published import published

__all__ = ["ARCHITECTURES", "Cost", "Counts", "Prices", "cost", "prices", "unrolled"]

ARCHITECTURES = ("multipass", "branching")

_WORD_BYTES = 4

#: Kernels in the paper's order.
KERNELS = ("generate eye ray", "set up", "step", "intersect", "color")


class Prices(NamedTuple):
    """The cost of one run of a kernel: a row of Table 1.

    Attributes
    ----------
    instructions : float
    read, written : float
        Words of 4 bytes of a ray's state between passes.
    memory : float
        Words of random texture reads: grid, lists, triangles, shading data.
    stencil_read, stencil_written : float
        Bytes.
    """

    instructions: float
    read: float
    written: float
    memory: float
    stencil_read: float
    stencil_written: float


class Counts(NamedTuple):
    """The number of runs of each kernel for an image.

    Attributes
    ----------
    rays : int
        R: camera rays.
    entering : int
        Rays that hit the scene's box and are set up.
    steps, tests, shadings : int
        R v, R t and R s.
    passes : int
        P; 0 on the branching architecture.
    """

    rays: int
    entering: int
    steps: int
    tests: int
    shadings: int
    passes: int = 0

    def of(self, kernel: str) -> int:
        """Runs of a kernel, by its name in Table 1."""
        runs = (self.rays, self.entering, self.steps, self.tests, self.shadings)
        return dict(zip(KERNELS, runs, strict=True))[kernel]


class Cost(NamedTuple):
    """The cost of an image.

    Attributes
    ----------
    instructions : dict of str to float
        By kernel.
    state, data, stencil : dict of str to float
        Bytes of ray state, of scene data and of the stencil, by kernel; the stencil reads of passes
        are under ``"passes"``.
    """

    instructions: dict[str, float]
    state: dict[str, float]
    data: dict[str, float]
    stencil: dict[str, float]

    @property
    def all_instructions(self) -> float:
        """Instructions of all kernels."""
        return sum(self.instructions.values())

    @property
    def bytes_by_kernel(self) -> dict[str, float]:
        """Bytes of each kernel and of ``"passes"``."""
        names = dict.fromkeys([*self.state, *self.stencil])
        parts = (self.state, self.data, self.stencil)
        return {name: sum(part.get(name, 0.0) for part in parts) for name in names}

    @property
    def all_bytes(self) -> float:
        """Total bytes."""
        return sum(sum(part.values()) for part in (self.state, self.data, self.stencil))


def prices(architecture: str) -> dict[str, Prices]:
    """Look up Table 1 for an architecture.

    Parameters
    ----------
    architecture : {"multipass", "branching"}
    """
    table = published("purcell", "table 1").values[architecture]
    return {kernel: Prices(**row) for kernel, row in table.items()}


def cost(counts: Counts, table: Mapping[str, Prices]) -> Cost:
    """Compute the cost of an image.

    Parameters
    ----------
    counts : Counts
    table : mapping of str to Prices
        Costs per kernel; see `prices`.

    Notes
    -----
    Purcell charges the stencil of all rays in each pass, whether or not the kernel runs on them;
    this includes the stencil reads of the runs.
    """
    runs = {kernel: counts.of(kernel) for kernel in KERNELS}
    rows = {kernel: table[kernel] for kernel in KERNELS}
    stencil = {kernel: runs[kernel] * rows[kernel].stencil_written for kernel in KERNELS}
    return Cost(
        {kernel: runs[kernel] * rows[kernel].instructions for kernel in KERNELS},
        {
            kernel: runs[kernel] * (rows[kernel].read + rows[kernel].written) * _WORD_BYTES
            for kernel in KERNELS
        },
        {kernel: runs[kernel] * rows[kernel].memory * _WORD_BYTES for kernel in KERNELS},
        {**stencil, "passes": float(counts.rays * counts.passes)},
    )


def unrolled(kernel: str, times: int) -> Prices:
    """The cost of a multipass kernel that takes several steps per pass.

    Parameters
    ----------
    kernel : {"step", "intersect"}
    times : int
        Steps or triangles.

    Notes
    -----
    The overhead of a pass is the difference between the two architectures in Table 1: the branching
    kernel does the same without loading and storing a ray's state. An unrolled kernel pays the
    overhead, state and stencil once, and the step itself `times` times.
    """
    whole, bare = prices("multipass")[kernel], prices("branching")[kernel]
    around = whole.instructions - bare.instructions
    return whole._replace(
        instructions=around + times * bare.instructions, memory=times * whole.memory
    )
