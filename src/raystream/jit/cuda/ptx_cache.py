"""The on-disk cache of PTX, in the folder of the CPU's kernels."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from raystream.core.atomic_write import atomic_write
from raystream.core.cache_folder import is_private, kernel_folder
from raystream.jit.cache import mark_used
from raystream.jit.fingerprint import cuda_generator_hash, fingerprint, type_name


def path_of(
    function: Callable[..., Any], arguments: Sequence[Any], capability: Any, version: str
) -> Path | None:
    """Path of a compiled function; None if changes of its code cannot be detected, or kept.

    Parameters
    ----------
    function : callable
    arguments : sequence
        Numba types.
    capability : (int, int)
    version : str
        Of the compiler.
    """
    known, types = fingerprint(function), [type_name(one) for one in arguments]
    if known is None or None in types or not is_private(kernel_folder()):
        return None
    text = f"{known} {cuda_generator_hash()} {types} {capability} {version}"
    digest = hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:32]
    return kernel_folder() / f"{function.__name__}-{digest}.ptx"


def cached_text(path: Path | None, make: Callable[[], str]) -> str:
    """Read a file; if it is missing, make its text, and write it where the folder allows that."""
    if path is None:
        return make()
    try:
        text = path.read_text(encoding="ascii")
        mark_used(path)
        return text
    except (OSError, UnicodeDecodeError):
        text = make()
    try:
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        with atomic_write(path) as file:
            file.write_text(text, encoding="ascii")
    except OSError:
        pass  # read-only: each process compiles it
    return text
