"""Query kernels: the CPU's answers for rays, one ray per CUDA thread.

A thread reads its ray where the caller has it, transforms it to the local frame, traverses the
structure, and writes world distances.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from raystream.jit.cuda import RangeKernel
from raystream.kernels.answers import thread_of
from raystream.kernels.queries import RayAnswers, RaySearches, ray_answers


def make_kernels(
    traverse: Callable[..., Any],
    stack_bytes: int,
    make_searches: Callable[[Callable[..., Any]], RaySearches],
) -> RayAnswers:
    """Make the kernels of a structure.

    Parameters
    ----------
    traverse, stack_bytes, make_searches
        See `kernels.queries.ray_queries`.

    Returns
    -------
    RayAnswers
        Of RangeKernel; each takes ``(scene, out)``.
    """
    answers = ray_answers(make_searches(traverse))
    return RayAnswers(*(RangeKernel(thread_of(answer, stack_bytes)) for answer in answers))
