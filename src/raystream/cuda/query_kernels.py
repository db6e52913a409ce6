"""Query kernels: the CPU's answers for rays, one ray per CUDA thread.

A thread reads its ray where the caller has it, transforms it to the local frame, traverses the
structure, and writes world distances.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from raystream.jit.cuda import RangeKernel
from raystream.kernels.answers import thread_of
from raystream.kernels.queries import RaySearches, ray_answers


class QueryKernels(NamedTuple):
    """The kernels of a structure, from `make_kernels`."""

    first_hit: RangeKernel
    any_hit: RangeKernel
    count_hits: RangeKernel
    multi_hit: RangeKernel


def make_kernels(
    traverse: Callable[..., Any],
    stack_bytes: int,
    make_searches: Callable[[Callable[..., Any]], RaySearches],
) -> QueryKernels:
    """Make the kernels of a structure.

    Parameters
    ----------
    traverse, stack_bytes, make_searches
        See `kernels.queries.ray_queries`.

    Returns
    -------
    QueryKernels
        Each takes ``(scene, out)``; see `kernels.queries.RayAnswers`.
    """
    answers = ray_answers(make_searches(traverse))
    return QueryKernels(*(RangeKernel(thread_of(answer, stack_bytes)) for answer in answers))
