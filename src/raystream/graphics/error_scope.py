"""Errors of a graphics device, raised as one GraphicsError of the query."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterator

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.errors import GraphicsError

#: Functions of wgpu that log errors which no call raises: those between calls, and a loss.
_REPORTERS = ("log_error", "device_lost_callback")


@contextlib.contextmanager
def guarded(opened: OpenDevice) -> Iterator[None]:
    """Lock a device, and raise its errors as `GraphicsError`.

    Errors are exceptions of wgpu, and those that it only logs because they happened between two
    calls. A lost device raises in every query: only a new tracer opens another one.

    Raises
    ------
    GraphicsError
        At the end of the block; at once if the device was lost before.
    """
    with opened.lock, _listening() as reports:
        if opened.is_known_lost:
            raise GraphicsError(_loss_of(opened))
        with _raising(opened):
            yield
        if reports:
            lost = opened.is_lost
            what = f"device 'graphics': {opened.adapter}: {reports[0]}"
            raise GraphicsError(_loss_of(opened) if lost else what)


@contextlib.contextmanager
def _raising(opened: OpenDevice) -> Iterator[None]:
    import wgpu

    try:
        yield
    except (wgpu.GPUError, GraphicsError) as error:
        if opened.is_lost:
            raise GraphicsError(_loss_of(opened)) from error
        if isinstance(error, GraphicsError):
            raise
        raise GraphicsError(f"device 'graphics': {opened.adapter}: {error}") from error


def _loss_of(opened: OpenDevice) -> str:
    return (
        f"device 'graphics': {opened.adapter} was lost (its driver was reset, or the device was "
        "destroyed); make a new tracer or new streams, or use device='cpu'"
    )


@contextlib.contextmanager
def _listening() -> Iterator[list[str]]:
    """Collect errors that wgpu would log."""
    reports: list[str] = []

    def hear(record: logging.LogRecord) -> bool:
        if record.levelno < logging.ERROR or record.funcName not in _REPORTERS:
            return True
        reports.append(record.getMessage())
        return False

    logger = logging.getLogger("wgpu")
    logger.addFilter(hear)
    try:
        yield reports
    finally:
        logger.removeFilter(hear)
