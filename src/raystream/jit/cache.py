"""The on-disk cache of compiled kernels.

Numba's own cache watches only the file that defines a kernel: edit a function that the kernel
calls, and the old code still runs. Here a file is named by a hash of all that the code in it
depends on: the kernel with everything that it calls or closes over (see `fingerprint`), the types
of its arguments, versions and the processor. So an edit recompiles what depends on it and nothing
else, nothing is ever stale, and versions of raystream share the folder. It is in the user's cache
folder (or ``RAYSTREAM_CACHE_DIR``), never beside the sources. Of several processes that need a
kernel which is not there yet, one compiles it and the others wait.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import pickle
import shutil
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

from numba.core import config, sigutils
from numba.core.caching import _Cache
from numba.core.compiler import CompileResult

from raystream.core.atomic_write import atomic_write
from raystream.core.cache_folder import cache_folder
from raystream.jit.compile_events import LISTENERS
from raystream.jit.compile_lock import CompileLock
from raystream.jit.compilers import collector_resting
from raystream.jit.fingerprint import fingerprint, type_name

__all__ = [
    "KERNELS",
    "KernelCache",
    "cache_folder",
    "evict",
    "keep_on_disk",
    "kernel_folder",
    "mark_used",
]

#: Bytes that the folder may grow to. All kernels that the tests compile take about 30 MB.
SIZE_LIMIT = 500_000_000

#: Seconds after which a file that was not used goes: 90 days.
AGE_LIMIT = 90 * 86_400.0

#: Kernels, PTX, and hashes of what runs at compile time (see `fingerprint`).
_SUFFIXES = (".nbc", ".ptx", ".txt")

#: Seconds between two notes that a file is used: a day. Reading costs a write no more often.
USE_INTERVAL = 86_400.0


#: Kernels by name: module, name in the module, and what a function that makes kernels was given.
KERNELS: WeakValueDictionary[str, Any] = WeakValueDictionary()


def kernel_folder() -> Path:
    """Folder of compiled kernels; it may be missing, or impossible to write."""
    return cache_folder() / "kernels"


@cache
def _lock_in(folder: Path) -> CompileLock:
    return CompileLock(folder)


class KernelCache(_Cache):
    """The cache of one kernel, in the form that Numba's dispatchers ask.

    Parameters
    ----------
    function : callable
        The kernel in Python. If it uses something whose changes cannot be noticed, nothing is
        kept.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function
        self._is_enabled = True
        self.name = name_of(function)
        self._begun: dict[Any, float] = {}  # when compiling began
        self._waiting: dict[Any, Path] = {}  # files that this process holds the locks of

    @property
    def cache_path(self) -> str:
        """The folder."""
        return str(kernel_folder())

    def enable(self) -> None:
        """Read and write files from now on."""
        self._is_enabled = True

    def disable(self) -> None:
        """Neither read nor write files from now on."""
        self._is_enabled = False

    def flush(self) -> None:
        """Do nothing: what is old goes by itself."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Read a compiled kernel; None leaves the caller, and no other process, to compile it."""
        target_context.refresh()
        path = self._path(sig, target_context.codegen())
        if path is None:
            return None
        found = _read(path, target_context)
        if found is None:
            self._begin(sig)
            if _lock_in(path.parent).acquire(path.name):
                self._waiting[sig] = path
                found = _read(path, target_context)  # written in the meantime?
            if found is not None:
                self.release_lock(sig)
        return found

    def is_on_disk(self, sig: Any, target_context: Any) -> bool:
        """Whether there is a file for a signature."""
        path = self._path(sig, target_context.codegen())
        return path is not None and path.exists()

    def is_free(self, sig: Any, target_context: Any) -> bool:
        """Whether a signature is not on disk, and no other process is compiling it."""
        path = self._path(sig, target_context.codegen())
        if (
            path is None
            or path.exists()
            or not _lock_in(path.parent).acquire(path.name, timeout=0.0)
        ):
            return False
        _lock_in(path.parent).release(path.name)
        return True

    def save_overload(self, sig: Any, data: Any) -> None:
        """Write a compiled kernel, if there is a folder that can be written."""
        try:
            path = self._path(sig, data.codegen)
            if path is None or data.lifted or data.library.has_dynamic_globals:
                return  # the code contains addresses of this process
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            with atomic_write(path) as file:
                file.write_bytes(pickle.dumps(data._reduce(), protocol=pickle.HIGHEST_PROTOCOL))
            _evict_once(path.parent)
        except OSError:
            self.disable()  # no folder to write to: compile in every process
        finally:
            self.release_lock(sig)

    def _begin(self, sig: Any) -> None:
        self._begun[sig] = time.perf_counter()
        for watcher in LISTENERS:
            watcher.begin(self.name)

    def release_lock(self, sig: Any) -> None:
        """Let other processes compile the kernel, if this one holds its lock."""
        begun = self._begun.pop(sig, None)
        if begun is not None:
            for watcher in LISTENERS:
                watcher.end(self.name, time.perf_counter() - begun)
        path = self._waiting.pop(sig, None)
        if path is not None:
            _lock_in(path.parent).release(path.name)

    def _path(self, sig: Any, codegen: Any) -> Path | None:
        """The file of a signature; None if changes of the code could not be noticed."""
        known = fingerprint(self._function) if self._is_enabled else None
        types = [type_name(one) for one in sigutils.normalize_signature(sig)[0]]
        if known is None or None in types:
            return None
        place = f"{self._function.__module__}.{self._function.__qualname__}"
        options = (
            config.OPT,
            config.LOOP_VECTORIZE,
            config.SLP_VECTORIZE,
            config.DEBUGINFO_DEFAULT,
        )
        text = f"{place} {known} {types} {codegen.magic_tuple()} {options}"
        digest = hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:32]
        return kernel_folder() / f"{self._function.__name__}-{digest}.nbc"


def name_of(function: Callable[..., Any]) -> str:
    """A kernel's name in `KERNELS`; a kernel made by a function names what that was given."""
    given = [cell.cell_contents for cell in function.__closure__ or ()]
    parts = [
        f"{one.__module__}.{one.__qualname__}" if hasattr(one, "__qualname__") else repr(one)
        for one in (getattr(value, "py_func", value) for value in given)
    ]
    name = f"{function.__module__}:{function.__qualname__}"
    return f"{name}[{', '.join(parts)}]" if parts else name


def _read(path: Path, target_context: Any) -> Any:
    """The compiled kernel of a file; None if there is none, or it is damaged."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    try:
        found = CompileResult._rebuild(target_context, *pickle.loads(content))
    except Exception:  # a truncated or unreadable file is a miss, not an error
        return None
    mark_used(path)
    return found


def mark_used(path: Path) -> None:
    """Note that a file of the folder was read, so that it stays."""
    with contextlib.suppress(OSError):
        if time.time() - path.stat().st_mtime > USE_INTERVAL:
            os.utime(path)


@cache
def _evict_once(folder: Path) -> None:
    evict(folder)


def evict(folder: Path) -> None:
    """Remove what was not used for long, and what was least recently used past a size.

    Parameters
    ----------
    folder : Path
        Of compiled kernels. Files that other processes remove at the same time are no error.
    """
    now, left = time.time(), SIZE_LIMIT
    entries = []
    for path in folder.iterdir():
        with contextlib.suppress(OSError):
            status = path.stat()
            entries.append((status.st_mtime, status.st_size, path))
    for used, size, path in sorted(entries, reverse=True):
        left -= size
        if left >= 0 and now - used <= AGE_LIMIT:
            continue
        if path.is_dir():  # of a version that had a folder for each state of the sources
            shutil.rmtree(path, ignore_errors=True)
        elif path.suffix in _SUFFIXES:
            with contextlib.suppress(OSError):  # removed, or being read (Windows)
                path.unlink()


def keep_on_disk(dispatcher: Any) -> None:
    """Give a function that Numba compiles this cache."""
    kernel_cache = KernelCache(dispatcher.py_func)
    compile_or_load = dispatcher.compile

    def compile_with_lock(sig: Any) -> Any:
        try:
            with collector_resting:
                return compile_or_load(sig)
        except BaseException:  # Numba saves nothing, and does not tell the cache
            kernel_cache.release_lock(sig)
            raise

    KERNELS[kernel_cache.name] = dispatcher
    dispatcher._cache = kernel_cache
    dispatcher.compile = compile_with_lock
