"""Steps: a traversal cut into kernels, and the kernel that all of them end with."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from raystream.jit.cpu import device
from raystream.kernels.collect import sort_hits
from raystream.kernels.search import Search
from raystream.kernels.tally import SHADINGS
from raystream.machines.records import RayState, tick

__all__ = ["SHADE", "StepKernel", "Steps", "resumed", "with_shade"]

_DONE = np.uint8(RayState.DONE)
_ONE = np.uint64(1)


class StepKernel(NamedTuple):
    """One kernel of a traversal.

    Attributes
    ----------
    name : str
    state : RayState
        It runs on the rays in this state, and puts them into the next.
    function : callable
        Takes some of the records ``ray``, ``wanted``, ``found`` and ``place``, and the
        constants ``tree`` and ``query``. Returns the records named by `outputs`, then the state.
    outputs : tuple of str
        Of ``found`` and ``place``.
    limit : str
        Which of `Query`'s numbers says how many steps it does in one run: ``"steps"``,
        ``"tests"``, or ``""`` for one.
    """

    name: str
    state: RayState
    function: Callable[..., Any]
    outputs: tuple[str, ...]
    limit: str = ""


class Steps(NamedTuple):
    """A traversal as kernels.

    Attributes
    ----------
    kernels : tuple of StepKernel
        The one that begins comes first and the one that hands hits over last; each has its
        own state.
    place : dtype
        What a ray keeps of where it is.
    tree : NamedTuple
        What the functions get of the structure: numbers.
    stack_bytes : int
        Memory that each ray needs for itself, besides.
    grow : callable, optional
        Gives the same steps with more such memory, for rays that have `OVERFLOWN`.
    """

    kernels: tuple[StepKernel, ...]
    place: np.dtype[Any]
    tree: Any
    stack_bytes: int = 0
    grow: Callable[[], Steps] | None = None


@device
def resumed(hits, ray, wanted, found, query, seen):
    """The search of a ray as its records have it; what it meets is counted by `tick`.

    Parameters
    ----------
    hits : HitAddresses or None
        The query's, or None for one that only counts: two types, so that a kernel that tests
        triangles has a branch for each.
    ray, wanted, found, query
        See `StepKernel.function`.
    seen : SeenSet or None

    Returns
    -------
    Search
    """
    return Search(
        ray.t_min,
        found.t_far,
        np.uint64(found.count),
        wanted.capacity,
        hits,
        wanted.first,
        query.surfaces,
        seen,
        False,
        None,
    )


def shade(wanted, found, query, kernel):
    """Hand a ray's hits over: sorted, where several may have been kept."""
    count = np.uint64(found.count)
    if query.keep and wanted.capacity != _ONE:
        sort_hits(query.hits, wanted.first, count)
    tick(query, wanted, kernel, SHADINGS, count if query.keep else _ONE)
    return _DONE


SHADE = StepKernel("shade", RayState.SHADING, device(shade), ())


def with_shade(*kernels: StepKernel) -> tuple[StepKernel, ...]:
    """The kernels of a traversal, and the one that hands hits over."""
    return (*kernels, SHADE)
