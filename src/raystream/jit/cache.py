"""The on-disk cache of compiled kernels.

Numba's own cache watches only the file that defines a kernel: after an edit of a function that the
kernel calls, the old code still runs. Here a file is named by a hash of everything that its code
depends on: the kernel with all that it calls or closes over (see `fingerprint`), the types of its
arguments, versions and the processor. So an edit recompiles what depends on it and nothing else,
nothing is ever stale, and versions of raystream share the folder. It is in the user's cache folder
(or ``RAYSTREAM_CACHE_DIR``), never beside the sources. When several processes need a missing
kernel, one compiles it and the others wait. A wheel may bring kernels, too (`ready_kernels`); they
are found by the same hash.

A file is code that this process runs, so the folder is used only if no other user can write there.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import pickle
import shutil
import time
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

from numba.core import config, sigutils
from numba.core.caching import _Cache
from numba.core.compiler import CompileResult

from raystream.core.atomic_write import atomic_write
from raystream.core.cache_folder import is_own, is_private, kernel_folder
from raystream.jit.compile_events import LISTENERS
from raystream.jit.compile_lock import CompileLock
from raystream.jit.compilers import gc_paused
from raystream.jit.fingerprint import fingerprint, type_name
from raystream.jit.ready_kernels import machines_of

#: Maximum size of the folder in bytes. All kernels that the tests compile take about 30 MB.
SIZE_LIMIT = 500_000_000

#: Seconds after which an unused file is removed: 90 days.
AGE_LIMIT = 90 * 86_400.0

#: Kernels, PTX, and hashes of code that runs at compile time (see `fingerprint`).
_SUFFIXES = (".nbc", ".ptx", ".txt")

#: Seconds between two updates of a file's time of use: a day, so that reads cost few writes.
USE_INTERVAL = 86_400.0


#: Kernels by name: module, qualified name, and the closure of a kernel made by a function.
KERNELS: WeakValueDictionary[str, Any] = WeakValueDictionary()


@cache
def _lock_in(folder: Path) -> CompileLock:
    return CompileLock(folder)


class KernelCache(_Cache):
    """The cache of one kernel, with the interface that Numba's dispatchers use.

    Parameters
    ----------
    function : callable
        The kernel in Python. If it uses something whose changes cannot be detected, nothing is
        cached.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function
        self._is_enabled = True
        self._can_write = True
        self.name = name_of(function)
        self._start_times: dict[Any, float] = {}  # of compilation
        self._locked: dict[Any, Path] = {}  # files whose locks this process holds

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
        """Do nothing: unused files are evicted."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Read a compiled kernel, or return None after locking it for the caller to compile."""
        target_context.refresh()
        codegen = target_context.codegen()
        if self._file_name(sig, codegen.magic_tuple()) is None:
            return None
        path = self._path(sig, codegen)
        found = _read_own(path, target_context)
        if found is not None:
            return found
        for ready in self._ready_files(sig, codegen):
            found = _rebuilt(ready, target_context)
            if found is not None:
                return found
        self._begin(sig)
        if path is not None and _lock_in(path.parent).acquire(path.name):
            self._locked[sig] = path
            found = _read_own(path, target_context)  # another process may have written it
        if found is not None:
            self.release_lock(sig)
        return found

    def is_on_disk(self, sig: Any, target_context: Any) -> bool:
        """Whether there is a file for a signature."""
        codegen = target_context.codegen()
        path = self._path(sig, codegen)
        return (path is not None and path.exists()) or any(
            ready.exists() for ready in self._ready_files(sig, codegen)
        )

    def is_free(self, sig: Any, target_context: Any) -> bool:
        """Whether a signature is not on disk, and no other process is compiling it."""
        path = self._path(sig, target_context.codegen())
        if (
            path is None
            or self.is_on_disk(sig, target_context)
            or not _lock_in(path.parent).acquire(path.name, timeout=0.0)
        ):
            return False
        _lock_in(path.parent).release(path.name)
        return True

    def save_overload(self, sig: Any, data: Any) -> None:
        """Write a compiled kernel, if the folder can be written."""
        try:
            path = self._path(sig, data.codegen)
            if (
                not self._can_write
                or path is None
                or data.lifted
                or data.library.has_dynamic_globals
            ):
                return  # its code contains addresses of this process
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            with atomic_write(path) as file:
                file.write_bytes(pickle.dumps(data._reduce(), protocol=pickle.HIGHEST_PROTOCOL))
            path.chmod(path.stat().st_mode & ~0o022)  # whatever the umask: see `is_own`
            _evict_once(path.parent)
        except OSError:
            self._can_write = False  # each process compiles
        finally:
            self.release_lock(sig)

    def _begin(self, sig: Any) -> None:
        self._start_times[sig] = time.perf_counter()
        for listener in LISTENERS:
            listener.begin(self.name)

    def release_lock(self, sig: Any) -> None:
        """Release the kernel's lock, if this process holds it."""
        begun = self._start_times.pop(sig, None)
        if begun is not None:
            for listener in LISTENERS:
                listener.end(self.name, time.perf_counter() - begun)
        path = self._locked.pop(sig, None)
        if path is not None:
            _lock_in(path.parent).release(path.name)

    def _path(self, sig: Any, codegen: Any) -> Path | None:
        """The file of a signature; None if there is to be none."""
        name, folder = self._file_name(sig, codegen.magic_tuple()), kernel_folder()
        return folder / name if name is not None and is_private(folder) else None

    def _ready_files(self, sig: Any, codegen: Any) -> Iterator[Path]:
        """Files of the package that may hold a signature, the best first."""
        for folder, machine in machines_of(codegen.magic_tuple()):
            name = self._file_name(sig, machine)
            if name is not None:
                yield folder / name

    def _file_name(self, sig: Any, machine: tuple[str, str, str]) -> str | None:
        """The name of a signature's file; None if changes of the code cannot be detected."""
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
        text = f"{place} {known} {types} {machine} {options}"
        digest = hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:32]
        return f"{self._function.__name__}-{digest}.nbc"


def name_of(function: Callable[..., Any]) -> str:
    """A kernel's name in `KERNELS`, with the values that it closes over."""
    given = [cell.cell_contents for cell in function.__closure__ or ()]
    parts = [
        f"{one.__module__}.{one.__qualname__}" if hasattr(one, "__qualname__") else repr(one)
        for one in (getattr(value, "py_func", value) for value in given)
    ]
    name = f"{function.__module__}:{function.__qualname__}"
    return f"{name}[{', '.join(parts)}]" if parts else name


def _read_own(path: Path | None, target_context: Any) -> Any:
    """Read the compiled kernel of a file in the cache folder, or return None."""
    found = _rebuilt(path, target_context, is_trusted=False)
    if found is not None and path is not None:
        mark_used(path)
    return found


def _rebuilt(path: Path | None, target_context: Any, *, is_trusted: bool = True) -> Any:
    """Read a compiled kernel; None if its file is missing, damaged or not to be trusted."""
    if path is None:
        return None
    try:
        with path.open("rb") as file:
            if not (is_trusted or is_own(os.fstat(file.fileno()))):
                return None
            content = file.read()
    except OSError:
        return None
    try:
        return CompileResult._rebuild(target_context, *pickle.loads(content))
    except Exception:  # a truncated or unreadable file is a miss, not an error
        return None


def mark_used(path: Path) -> None:
    """Update the time of use of a file, which delays its eviction."""
    with contextlib.suppress(OSError):
        if time.time() - path.stat().st_mtime > USE_INTERVAL:
            os.utime(path)


@cache
def _evict_once(folder: Path) -> None:
    evict(folder)


def evict(folder: Path) -> None:
    """Remove files unused for `AGE_LIMIT`, and the least recently used beyond `SIZE_LIMIT`.

    Parameters
    ----------
    folder : Path
        Of compiled kernels. Other processes may remove files at the same time.
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
        if path.is_dir():  # older versions had a folder for each state of the sources
            shutil.rmtree(path, ignore_errors=True)
        elif path.suffix in _SUFFIXES:
            with contextlib.suppress(OSError):  # removed already, or being read (Windows)
                path.unlink()


def keep_on_disk(dispatcher: Any) -> None:
    """Attach this cache to a function compiled by Numba."""
    kernel_cache = KernelCache(dispatcher.py_func)
    compile_or_load = dispatcher.compile

    def compile_with_lock(sig: Any) -> Any:
        try:
            with gc_paused:
                return compile_or_load(sig)
        except BaseException:  # Numba does not notify the cache
            kernel_cache.release_lock(sig)
            raise

    KERNELS[kernel_cache.name] = dispatcher
    dispatcher._cache = kernel_cache
    dispatcher.compile = compile_with_lock
