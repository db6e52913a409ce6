"""Kernels generated as Python source, and compiled like any other."""

from __future__ import annotations

import hashlib
import linecache
import re
from collections.abc import Callable, Mapping
from typing import Any

from raystream.jit.cpu import kernel

_NAME = re.compile(r"^def (\w+)\(", re.MULTILINE)


def kernel_from_source(text: str, names: Mapping[str, Any], module: str) -> Callable[..., Any]:
    """Make a kernel from source that defines a function alone.

    Parameters
    ----------
    text : str
        Source with one function on the top level.
    names : mapping
        Globals that it uses.
    module : str
        The module of raystream that generated it.
    """
    name = _NAME.findall(text)[0]
    digest = hashlib.sha256(text.encode()).hexdigest()[:24]
    file = f"source_of_{name}_{digest}.py"  # not on disk
    linecache.cache[file] = (len(text), None, text.splitlines(True), file)  # for error messages
    namespace = {"__name__": module, **names}
    exec(compile(text, file, "exec"), namespace)
    return kernel(namespace[name])
