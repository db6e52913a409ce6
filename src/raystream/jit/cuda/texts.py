"""Kernels that are written as text, and compiled like any other."""

from __future__ import annotations

import linecache
from collections.abc import Callable, Mapping
from typing import Any

import numba

from raystream.jit.cpu import FLAGS, device, kernel
from raystream.jit.fingerprint import fingerprint

__all__ = ["device_of_text", "kernel_of_text"]


def kernel_of_text(text: str, names: Mapping[str, Any], module: str) -> Callable[..., Any]:
    """Make a kernel of text that defines one function.

    It is kept on disk if changes of what it uses can be noticed; see `fingerprint`.

    Parameters
    ----------
    text : str
        Begins with ``def`` and the function's name.
    names : mapping
        What it uses.
    module : str
        The module of raystream that wrote it.
    """
    function = _function(text, names, module)
    if fingerprint(function) is None:
        compiled: Callable[..., Any] = numba.njit(**FLAGS)(function)
        return compiled
    return kernel(function)


def device_of_text(text: str, names: Mapping[str, Any], module: str) -> Callable[..., Any]:
    """Make a function that kernels call; see `kernel_of_text`."""
    return device(_function(text, names, module))


def _function(text: str, names: Mapping[str, Any], module: str) -> Callable[..., Any]:
    """The function, whose name in full says what it uses."""
    name = text.removeprefix("def ").partition("(")[0]
    namespace = {"__name__": module, **names}
    exec(compile(text, f"text_of_{name}.py", "exec"), namespace)
    key = fingerprint(namespace[name])
    file = f"text_of_{name}_{key}.py"  # there is no such file
    linecache.cache[file] = (len(text), None, text.splitlines(True), file)  # for error messages
    exec(compile(text, file, "exec"), namespace)
    function: Callable[..., Any] = namespace[name]
    function.__qualname__ = f"{name}_{key}"
    return function
