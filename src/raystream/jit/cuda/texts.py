"""Kernels that are written as text, and compiled like any other."""

from __future__ import annotations

import hashlib
import linecache
from collections.abc import Callable, Mapping
from typing import Any

from raystream.jit.cpu import device, kernel

__all__ = ["device_of_text", "kernel_of_text"]


def kernel_of_text(text: str, names: Mapping[str, Any], module: str) -> Callable[..., Any]:
    """Make a kernel of text that defines one function.

    Parameters
    ----------
    text : str
        Begins with ``def`` and the function's name.
    names : mapping
        What it uses.
    module : str
        The module of raystream that wrote it.
    """
    return kernel(_function(text, names, module))


def device_of_text(text: str, names: Mapping[str, Any], module: str) -> Callable[..., Any]:
    """Make a function that kernels call; see `kernel_of_text`."""
    return device(_function(text, names, module))


def _function(text: str, names: Mapping[str, Any], module: str) -> Callable[..., Any]:
    name = text.removeprefix("def ").partition("(")[0]
    digest = hashlib.sha256(text.encode()).hexdigest()[:24]
    file = f"text_of_{name}_{digest}.py"  # there is no such file
    linecache.cache[file] = (len(text), None, text.splitlines(True), file)  # for error messages
    namespace = {"__name__": module, **names}
    exec(compile(text, file, "exec"), namespace)
    function: Callable[..., Any] = namespace[name]
    return function
