"""Trace: a program and its payload at the hits of every ray."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import RayBatch
from raystream.core.triangles import Triangles
from raystream.jit.threads import Progress
from raystream.programs.asked import Asked
from raystream.programs.payloads import as_payload, as_records
from raystream.programs.program import Program
from raystream.programs.rounds import AskHits, visit

__all__ = ["ORDERS", "Order", "check_order", "trace_program"]

#: How a ray's hits are given to a program.
Order = Literal["front-to-back", "any"]
ORDERS: tuple[str, ...] = ("front-to-back", "any")

#: Runs a function on records, elsewhere; False if it cannot.
RunThere = Callable[[Callable[..., Any], "NDArray[Any] | None"], bool]


def check_order(order: str) -> None:
    """Raise ValueError for an unknown word."""
    if order not in ORDERS:
        known = " or ".join(map(repr, ORDERS))
        raise ValueError(f"order: expected {known}, got {order!r}")


def trace_program(
    ask: AskHits,
    batch: RayBatch,
    triangles: Triangles,
    function: Callable[..., Any],
    payload: Any,
    order: str,
    progress: Progress | None,
    run_there: RunThere | None = None,
) -> NDArray[Any] | None:
    """Run a program at the hits of each ray.

    Parameters
    ----------
    ask : callable
        The query for hits.
    batch : RayBatch
    triangles : Triangles
    function : callable
    payload : ndarray, dtype or None
    order : {"front-to-back", "any"}
        "any": packets of rays need not sort what they find.
    progress : callable, optional
    run_there : callable, optional
        Runs the function elsewhere, on records of `as_records`; False if it has to run here.

    Returns
    -------
    ndarray or None
        The payload.
    """
    check_order(order)
    result = records = None
    if payload is not None:
        result = as_payload(payload, batch.shape)
        records = as_records(result, batch.shape)
    if run_there is None or not run_there(function, records):
        program = Program(function, "trace", None, (records,), triangles)
        program.compile()
        whole, status = Asked(batch, None, 0), np.zeros(len(batch), np.uint8)
        visit(ask, whole, program.run, status, progress, is_ordered=order != "any")
    if result is not None and records is not None and not np.shares_memory(result, records):
        result[...] = records.reshape(result.shape)
    return result
