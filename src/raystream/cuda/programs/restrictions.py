"""Checks whether a filter or program runs on a GPU, and explains why not."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from raystream.cuda.programs.device_program import DeviceProgram
from raystream.cuda.programs.payload import record_of
from raystream.jit.cuda import CAPABILITIES
from raystream.programs.payloads import as_payload, as_records


def reason_against(
    function: Callable[..., Any],
    payload: Any = None,
    capability: tuple[int, int] = CAPABILITIES[0],
) -> str | None:
    """Explain why a function would run on the CPU on a tracer with ``device="cuda"``.

    Compiles the function; needs no GPU.

    Parameters
    ----------
    function : callable
        A filter ``(hit)`` or a program ``(hit, payload)``.
    payload : ndarray or dtype, optional
        For a program.
    capability : (int, int)
        Compute capability of the GPU.

    Returns
    -------
    str or None
        None if it runs on the GPU.

    Raises
    ------
    TypeError, ValueError
        If the function is neither a filter nor a program, or the payload is not valid.
    """
    own = getattr(function, "py_func", function)
    is_filter = inspect.isfunction(own) and len(inspect.signature(own).parameters) == 1
    record = None
    if payload is not None:
        result = as_payload(payload, getattr(payload, "shape", (0,)))
        record = record_of(as_records(result, result.shape))
    program = DeviceProgram(function, "first" if is_filter else "trace", record=record)
    return program.reason_against(capability)
