"""Cost model: instructions and bytes of a picture from what its rays meet (Purcell 2002, 3.2).

``C = R (C_r + v C_v + t C_t + s C_s) + R P C_stencil``: each kernel's price, of Table 1, times how
often it runs. On the multipass architecture every pass reads the stencil of every ray.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from raystream.lab.published import published

__all__ = ["ARCHITECTURES", "Cost", "Counts", "Prices", "cost", "prices", "unrolled"]

ARCHITECTURES = ("multipass", "branching")

_WORD_BYTES = 4

#: Kernels in the order in which the paper lists them.
KERNELS = ("generate eye ray", "set up", "step", "intersect", "color")


class Prices(NamedTuple):
    """What one run of a kernel costs: a row of Table 1.

    Attributes
    ----------
    instructions : float
    read, written : float
        Words of 4 bytes that a ray keeps between passes.
    memory : float
        Words of textures that are read at random: grid, lists, triangles, shading data.
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
    """How often each kernel runs in a picture.

    Attributes
    ----------
    rays : int
        R: rays from the eye.
    entering : int
        Those that meet the scene's box, and are set up.
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
    """What a picture costs.

    Attributes
    ----------
    instructions : dict of str to float
        By kernel.
    state, data, stencil : dict of str to float
        Bytes of each ray's state, of the scene's data, and of the stencil, by kernel; the
        stencils that passes read are under ``"passes"``.
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
        """Bytes of each kernel, and ``"passes"``."""
        names = dict.fromkeys([*self.state, *self.stencil])
        parts = (self.state, self.data, self.stencil)
        return {name: sum(part.get(name, 0.0) for part in parts) for name in names}

    @property
    def all_bytes(self) -> float:
        """Bytes of everything."""
        return sum(sum(part.values()) for part in (self.state, self.data, self.stencil))


def prices(architecture: str) -> dict[str, Prices]:
    """Table 1 of an architecture.

    Parameters
    ----------
    architecture : {"multipass", "branching"}
    """
    table = published("purcell", "table 1").values[architecture]
    return {kernel: Prices(**row) for kernel, row in table.items()}


def cost(counts: Counts, table: Mapping[str, Prices]) -> Cost:
    """Price a picture.

    Parameters
    ----------
    counts : Counts
    table : mapping of str to Prices
        Such as `prices` gives.

    Notes
    -----
    Purcell charges the stencil of all rays in each pass, whether the kernel runs on them or
    not; the runs' own stencil reads are among those.
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
    """A kernel of the multipass architecture that does several steps in a pass.

    Parameters
    ----------
    kernel : {"step", "intersect"}
    times : int
        Steps, or triangles.

    Notes
    -----
    What a pass adds to a step is the difference between the two architectures in Table 1: the
    branching kernel does the same without fetching and keeping a ray's state. An unrolled kernel
    pays that once, and the step itself `times` times; state and stencil once.
    """
    whole, bare = prices("multipass")[kernel], prices("branching")[kernel]
    around = whole.instructions - bare.instructions
    return whole._replace(
        instructions=around + times * bare.instructions, memory=times * whole.memory
    )
