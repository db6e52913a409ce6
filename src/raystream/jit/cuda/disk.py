"""PTX on disk, beside the CPU's kernels."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from raystream.core.atomic_write import atomic_write
from raystream.jit.cache import kernel_folder, mark_used
from raystream.jit.fingerprint import cuda_generator_hash, fingerprint, type_name

__all__ = ["kept", "path_of"]


def path_of(
    function: Callable[..., Any], arguments: Sequence[Any], capability: Any, version: str
) -> Path | None:
    """The file of a compiled function; None if changes of it could not be noticed.

    Parameters
    ----------
    function : callable
    arguments : sequence
        Numba's types.
    capability : (int, int)
    version : str
        Of the compiler.
    """
    known, types = fingerprint(function), [type_name(one) for one in arguments]
    if known is None or None in types:
        return None
    text = f"{known} {cuda_generator_hash()} {types} {capability} {version}"
    digest = hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:32]
    return kernel_folder() / f"{function.__name__}-{digest}.ptx"


def kept(path: Path | None, make: Callable[[], str]) -> str:
    """The text of a file; if there is none, it is made, and kept if the folder can be written."""
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
        pass  # read-only: it is compiled in each process
    return text
