"""Why a function runs on the CPU although rays are traced on a GPU."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from raystream.cuda.programs.device_program import DeviceProgram
from raystream.cuda.programs.payload import record_of
from raystream.jit.cuda import CAPABILITIES
from raystream.programs.payloads import as_payload, as_records

__all__ = ["reason_against"]


def reason_against(
    function: Callable[..., Any],
    payload: Any = None,
    capability: tuple[int, int] = CAPABILITIES[0],
) -> str | None:
    """Why a function would run on the CPU on a tracer with ``device="cuda"``.

    It is compiled for that, which needs no GPU.

    Parameters
    ----------
    function : callable
        A filter, of a hit; or a program, of a hit and a payload.
    payload : ndarray or dtype, optional
        Of a program.
    capability : (int, int)
        Of the GPU.

    Returns
    -------
    str or None
        None if it runs on the GPU.

    Raises
    ------
    TypeError, ValueError
        If it is neither a filter nor a program, or the payload is none.
    """
    own = getattr(function, "py_func", function)
    is_filter = inspect.isfunction(own) and len(inspect.signature(own).parameters) == 1
    record = None
    if payload is not None:
        result = as_payload(payload, getattr(payload, "shape", (0,)))
        record = record_of(as_records(result, result.shape))
    program = DeviceProgram(function, "first" if is_filter else "trace", record=record)
    return program.reason_on(capability)
