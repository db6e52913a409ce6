"""Errors of the WGSL compiler, by the kernel and the line of its source."""

from __future__ import annotations

import logging
import re

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.errors import GraphicsError
from raystream.graphics.pipelines import shader_module

#: The compiler's message, and where it points.
_MESSAGE = re.compile(r"^Shader (?:'.*' parsing|validation) error: (.*)$", re.MULTILINE)
_PLACE = re.compile(r"^\s*┌─ .*:(\d+):(\d+)\s*$", re.MULTILINE)
_NOTE = re.compile(r"^\s*= (.*)$", re.MULTILINE)


def check_source(opened: OpenDevice, name: str, source: str, line_count: int) -> None:
    """Compile a program.

    Parameters
    ----------
    opened : OpenDevice
    name : str
        Of the kernel.
    source : str
        The kernel's own source, followed by generated code.
    line_count : int
        Lines of the kernel's own source.

    Raises
    ------
    GraphicsError
        With the kernel's name and the line, if it does not compile.
    """
    logger = logging.getLogger("wgpu")
    logger.addFilter(_is_no_detail)
    try:
        shader_module(opened, source, name)
    except GraphicsError as error:
        if opened.is_lost:
            raise
        raise GraphicsError(_told(name, str(error), line_count)) from error
    finally:
        logger.removeFilter(_is_no_detail)


def _is_no_detail(record: logging.LogRecord) -> bool:
    """Whether it is not a detail of an error, which the compiler logs before it fails."""
    return record.funcName != "_logger_callback"


def _told(name: str, report: str, line_count: int) -> str:
    message, place, note = _MESSAGE.search(report), _PLACE.search(report), _NOTE.search(report)
    if message is None:
        return f"kernel {name}: does not compile: {' '.join(report.split())}"
    text = message[1] if note is None else f"{message[1]}: {note[1]}"
    if place is None:
        return f"kernel {name}: {text}"
    line = int(place[1])
    if line > line_count:
        return f"kernel {name}: {text} (where its function meets streams and constants)"
    return f"kernel {name}, line {line}: {text}"
