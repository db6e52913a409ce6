"""The on-disk cache of compiled kernels.

Numba's own cache watches only the file that defines a kernel: edit a function that the
kernel calls, and the old code still runs. This cache lives in a folder named by a hash of
every raystream source, so any change misses. The folder is in the user's cache folder (or
``RAYSTREAM_CACHE_DIR``), never beside the sources. Of several processes that need a kernel
which is not there yet, one compiles it and the others wait.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

from numba.core.caching import (
    CompileResultCacheImpl,
    FunctionCache,
    IndexDataCacheFile,
    _CacheLocator,
)
from numba.core.dispatcher import Dispatcher

from raystream.core.cache_folder import cache_folder
from raystream.jit.turns import Turns

__all__ = ["KernelCache", "cache_folder", "keep_on_disk", "kernel_folder", "source_hash"]

#: Folders of this many source versions stay; the least recently used go.
KEPT_VERSIONS = 4


@cache
def source_hash() -> str:
    """Hash of every Python source of raystream, 16 hexadecimal digits."""
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        content = path.read_bytes()
        digest.update(f"{path.relative_to(package).as_posix()} {len(content)}\n".encode())
        digest.update(content)
    return digest.hexdigest()[:16]


@cache
def kernel_folder() -> str:
    """Folder for this version's kernels; marks it as used and drops the oldest others."""
    parent = cache_folder() / "kernels"
    folder = parent / source_hash()
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        os.utime(folder)
        versions = sorted(parent.iterdir(), key=lambda path: path.stat().st_mtime)
        for old in versions[:-KEPT_VERSIONS]:
            if time.time() - old.stat().st_mtime > 3600.0:  # nobody is starting with it now
                shutil.rmtree(old, ignore_errors=True)
    except OSError:
        pass  # read-only or raced: numba finds out whether the folder can be used
    return str(folder)


@cache
def _turns(folder: str) -> Turns:
    return Turns(Path(folder))


class _Locator(_CacheLocator):
    """Where a kernel's files are, and what makes them stale."""

    def __init__(self, function: Callable[..., Any], source: str) -> None:
        code = function.__code__
        path = Path(source)
        self._py_file = source  # numba names it in its warnings
        self._disambiguator = f"{path.parent.name}.{path.stem}-{code.co_firstlineno}"

    def get_cache_path(self) -> str:
        return kernel_folder()

    def get_source_stamp(self) -> str:
        return source_hash()

    def get_disambiguator(self) -> str:
        return self._disambiguator

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> _Locator:
        return cls(py_func, py_file)


class _CacheImpl(CompileResultCacheImpl):
    _locator_classes: ClassVar = [_Locator]


class _CacheFile(IndexDataCacheFile):
    """Numba's index and data files, made safe for processes that write at the same time.

    Numba numbers the data files: two processes that save different signatures at once give
    them the same number, and one index then points to the other's code. Here a data file is
    named by its key, so the worst that a race can do is to forget an entry.
    """

    def save(self, key: Any, data: Any) -> None:
        name = self._name_of(key)
        self._save_data(name, data)
        overloads = self._load_index()
        overloads[key] = name
        self._save_index(overloads)

    def load(self, key: Any) -> Any:
        try:
            return super().load(key)
        except Exception:  # a truncated or unreadable file is a miss, not an error
            return None

    def _load_index(self) -> dict[Any, str]:
        try:
            index: dict[Any, str] = super()._load_index()
        except Exception:
            index = {}
        return index

    def _name_of(self, key: Any) -> str:
        digest = hashlib.sha256(repr(key).encode()).hexdigest()[:24]
        return self._index_name.removesuffix(".nbi") + f".{digest}.nbc"


class KernelCache(FunctionCache):
    """Numba's function cache with the folder, the freshness rule and the files above.

    Kernels made by a factory are cached too when all that they close over are numbers,
    strings or raystream's own compiled functions: those are named in the key, and the
    folder's hash stands for their code. (Numba would hash a pickle of the closure, which is
    new in every process.)
    """

    _impl_class = _CacheImpl

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._cache_file = _CacheFile(
            cache_path=self._cache_path,
            filename_base=self._impl.filename_base,
            source_stamp=self._impl.locator.get_source_stamp(),
        )
        self._turns_taken: dict[Any, str] = {}  # names of turns, by signature

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Read a compiled kernel; None leaves the caller, and no other process, to compile it."""
        found = super().load_overload(sig, target_context)
        if found is None and self._enabled:
            key = self._index_key(sig, target_context.codegen())
            name = self._cache_file._name_of(key)
            if _turns(self._cache_path).take(name):
                self._turns_taken[sig] = name
                found = super().load_overload(sig, target_context)  # written in the meantime?
                if found is not None:
                    self.end_turn(sig)
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Write a compiled kernel, if there is a folder that can be written."""
        try:
            super().save_overload(sig, data)
        except OSError:
            self.disable()  # no folder to write to: compile in every process
        finally:
            self.end_turn(sig)

    def end_turn(self, sig: Any) -> None:
        """Let other processes compile the kernel, if it was this one's turn."""
        name = self._turns_taken.pop(sig, None)
        if name is not None:
            _turns(self._cache_path).give(name)

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        closure = self._py_func.__closure__ or ()
        names = tuple(_name_of_cell(cell.cell_contents) for cell in closure)
        return (str(sig), codegen.magic_tuple(), self._py_func.__qualname__, names)


def keep_on_disk(dispatcher: Any) -> None:
    """Give a function that Numba compiles this cache."""
    kernel_cache = KernelCache(dispatcher.py_func)
    compile_or_load = dispatcher.compile

    def compile_in_turn(sig: Any) -> Any:
        try:
            return compile_or_load(sig)
        except BaseException:  # Numba saves nothing, and does not tell the cache
            kernel_cache.end_turn(sig)
            raise

    dispatcher._cache = kernel_cache
    dispatcher.compile = compile_in_turn


def _name_of_cell(value: object) -> str:
    if isinstance(value, Dispatcher):
        function = value.py_func
        if function.__closure__:
            raise TypeError(f"{function.__qualname__}: a closure cannot be part of a cache key")
        return f"{function.__module__}.{function.__qualname__}"
    if isinstance(value, bool | int | float | str):
        return repr(value)
    raise TypeError(f"a cached kernel cannot close over {type(value).__name__}")
