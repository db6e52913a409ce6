"""Measure the bandwidth of the key kernels, and whether they are bandwidth-bound.

Foley 2005, section 4.2: each kernel runs repeatedly on the rays of a scene, without masking or
scheduling, and so does a version of it that fetches and stores the same but computes next to
nothing. "Where the fetch-only versions exhibited the same performance as the full versions, we
concluded that the full versions were bandwidth-bound or near the crossover point."
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from raystream.jit.threads import parallel_for
from raystream.kernels.local_frame import LocalRays
from raystream.structures import Structure
from raystream_lab.kernels.costs import stream_words, words_fetched
from raystream_lab.kernels.fetch_only import FETCH_ONLY, fetch_only
from raystream_lab.kernels.memory_accesses import accesses
from raystream_lab.kernels.record_code import compile_steps
from raystream_lab.kernels.snapshots import Search, Snapshot, busiest, snapshots
from raystream_lab.timing import repeat, seconds_of

#: Foley's number of runs.
RUNS = 500

#: Passes of brute force to search for the busiest: all rays take part in each.
_BRUTE_PASSES = 8


@dataclass(frozen=True)
class KernelSpeed:
    """Times of a kernel and its fetch-only version on the same rays.

    Attributes
    ----------
    kernel : str
    ray_count : int
        Rays per run: all that waited for the kernel in its busiest pass.
    words_in, words_fetched, words_out : int
        Words of 4 bytes per ray: loaded from streams, read from the structure (each word once), and
        stored. Counted in the code of the fetch-only version, which has no branches that skip any
        of them.
    seconds, fetch_seconds : ndarray of shape (runs,)
        Per run of the kernel and of its fetch-only version, run in turn.
    """

    kernel: str
    ray_count: int
    words_in: int
    words_fetched: int
    words_out: int
    seconds: np.ndarray
    fetch_seconds: np.ndarray

    @property
    def byte_count(self) -> int:
        """Bytes read and written per run."""
        return 4 * self.ray_count * (self.words_in + self.words_fetched + self.words_out)

    @property
    def bandwidth(self) -> float:
        """Bytes per second at the median time."""
        return self.byte_count / float(np.median(self.seconds))

    @property
    def fetch_bandwidth(self) -> float:
        """The same for the fetch-only version."""
        return self.byte_count / float(np.median(self.fetch_seconds))

    @property
    def ratio(self) -> float:
        """Median time of the kernel over that of its fetch-only version."""
        return float(np.median(self.seconds) / np.median(self.fetch_seconds))

    def is_bandwidth_bound(self, slack: float = 0.25) -> bool:
        """Foley's rule: whether it takes about as long as its fetch-only version.

        Parameters
        ----------
        slack : float
            Allowed excess; our value: Foley gives no number for "the same performance".
        """
        return self.ratio <= 1.0 + slack


def kernel_speeds(
    structure: Structure, rays: LocalRays, *, runs: int = RUNS, scheduler: str = "threshold"
) -> list[KernelSpeed]:
    """Measure the key kernels of a structure on rays in mid-search.

    The search runs once to find the busiest pass of each kernel, and once more to capture the rays
    of these passes.

    Parameters
    ----------
    structure : Structure
        Brute force, a grid of one level, or a kd-tree.
    rays : LocalRays
        From `snapshots.local_rays`.
    runs : int
        Of each kernel and its fetch-only version.
    scheduler : str
        Scheduler of the search.

    Returns
    -------
    list of KernelSpeed
        In the order of `FETCH_ONLY`, without kernels that did not run.

    Raises
    ------
    ValueError
        If the structure has no key kernels, or is a two-level grid.
    """
    names = [kernel for name, kernel in FETCH_ONLY if name == structure.name]
    if not names:
        known = ", ".join(dict.fromkeys(name for name, _ in FETCH_ONLY))
        raise ValueError(f"structure: {structure.name!r} has no key kernels; choose of {known}")
    limit = _BRUTE_PASSES if structure.name == "brute" else None
    search = Search(structure, rays, scheduler)
    if getattr(search.steps.tree, "children", 0):
        raise ValueError("structure: key kernels need a one-level grid")
    passes = busiest(search, names, limit)
    taken = snapshots(Search(structure, rays, scheduler), passes)
    return [measure_speed(structure.name, taken[name], runs) for name in names if name in taken]


def measure_speed(structure: str, snapshot: Snapshot, runs: int = RUNS) -> KernelSpeed:
    """Time a kernel and its fetch-only version on the rays of a snapshot.

    Parameters
    ----------
    structure : str
        Its name.
    snapshot : Snapshot
    runs : int
    """
    fetching = fetch_only(structure, snapshot.steps, snapshot.number)
    kernels = snapshot.kernel()[0], snapshot.kernel(fetching)[0]
    record = compile_steps(fetching, snapshot.number, is_in_place=False)
    found = accesses(record.code.instructions)
    for kernel in kernels:  # compiles
        kernel.execute()
    times = np.array([[seconds_of(kernel.execute) for kernel in kernels] for _ in range(runs)])
    return KernelSpeed(
        kernels[0].name,
        len(snapshot),
        sum(stream_words(record, found, "load").values()),
        sum(one.words for one in words_fetched(record, found).values()),
        sum(stream_words(record, found, "store").values()),
        times[:, 0],
        times[:, 1],
    )


def copy_bandwidth(byte_count: int = 1 << 26, runs: int = 20) -> float:
    """Measure bytes read and written per second when copying an array on all threads.

    Parameters
    ----------
    byte_count : int
        Size of the array; exceed the caches to measure memory.
    runs : int
        The median is returned.
    """
    source, target = np.ones(byte_count, np.uint8), np.empty(byte_count, np.uint8)

    def copy(begin: int, end: int) -> None:
        target[begin:end] = source[begin:end]

    seconds = repeat(lambda: parallel_for(copy, byte_count, 1 << 20), runs)
    return 2 * byte_count / float(np.median(seconds))
