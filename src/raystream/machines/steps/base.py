"""A traversal as kernels, and the kernel that ends all of them: shading."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from raystream.jit.constants import ONE_U64
from raystream.jit.cpu import device
from raystream.kernels.search import Search, SearchGoal, sort_hits
from raystream.kernels.tally import SHADINGS
from raystream.machines.records import DONE, RayState, count_step


class StepKernel(NamedTuple):
    """One kernel of a traversal.

    Attributes
    ----------
    name : str
    state : RayState
        It runs on the rays in this state, and sets their next one.
    function : callable
        Takes any of the records ``ray``, ``wanted``, ``found`` and ``place``, and of the
        constants ``tree``, ``query`` and ``kernel``. Returns the records named by `outputs`, then
        the state.
    outputs : tuple of str
        ``"found"``, ``"place"``, or both.
    limit : str
        The field of `StepArguments` that holds the steps of a ray in one pass: ``"steps"`` or
        ``"tests"``; ``""`` for one step.
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
        Set-up first, shading last; each has its own state.
    place : dtype
        The traversal state of a ray.
    tree : NamedTuple
        The structure as the functions read it: numbers and addresses.
    stack_bytes : int
        Bytes of each ray's stack.
    """

    kernels: tuple[StepKernel, ...]
    place: np.dtype[Any]
    tree: Any
    stack_bytes: int = 0


@device
def resume_search(hits, ray, wanted, found, query):
    """The search of a ray as its records hold it.

    Its own counters are None: steps are counted by `count_step`. It has no filter.

    Parameters
    ----------
    hits : HitAddresses or None
        The query's. An argument of its own, so that code for None is left out.
    ray, wanted, found, query
        See `StepKernel.function`.

    Returns
    -------
    Search
    """
    goal = SearchGoal(wanted.capacity, hits, wanted.first, query.surfaces)
    return Search(ray.t_min, found.t_far, np.uint64(found.count), goal, None, None, None)


@device
def _sort_kept(hits, wanted, count):
    """Sort a ray's hits, where several may have been kept; returns the number of hits shaded."""
    if hits is None:
        return ONE_U64
    if wanted.capacity != ONE_U64:
        sort_hits(hits, wanted.first, count)
    return count


def shade(wanted, found, query, kernel):
    """End a ray: its hits are sorted, and counted as shaded."""
    count = _sort_kept(query.hits, wanted, np.uint64(found.count))
    count_step(query, wanted, kernel, SHADINGS, count)
    return DONE


_SHADE = StepKernel("shade", RayState.SHADING, device(shade), ())


def with_shade(*kernels: StepKernel) -> tuple[StepKernel, ...]:
    """The kernels of a traversal, and shading."""
    return (*kernels, _SHADE)


def traversal_kernels(
    set_up: Callable[..., Any], traverse: Callable[..., Any], intersect: Callable[..., Any]
) -> tuple[StepKernel, ...]:
    """The kernels of a traversal that has one step for nodes or cells, and one for triangles."""
    found_and_place = ("found", "place")
    return with_shade(
        StepKernel("set up", RayState.STARTING, device(set_up), found_and_place),
        StepKernel("traverse", RayState.TRAVERSING, device(traverse), ("place",), "steps"),
        StepKernel("intersect", RayState.INTERSECTING, device(intersect), found_and_place, "tests"),
    )
