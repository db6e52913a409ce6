"""Fingerprints of functions: a hash of everything that a function's compiled code depends on.

A fingerprint covers a function's bytecode and the values of its names: constants, other
functions, closures, the fields of named tuples, recursively. It leaves out docstrings, comments
and line numbers. Code that runs at compile time (intrinsics, overloads, vector types) cannot be
followed name by name, so all of those files count for every function; see `generator_hash`.
"""

from __future__ import annotations

import ast
import builtins
import contextlib
import dis
import enum
import hashlib
import re
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from opcode import opmap
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any

import llvmlite
import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core.dispatcher import Dispatcher
from numba.core.extending import _Intrinsic

from raystream.core.atomic_write import atomic_write
from raystream.core.cache_folder import is_private, kernel_folder
from raystream.jit import ready_kernels

_PACKAGE = Path(__file__).parents[1]

#: Modules whose attributes depend on their versions alone.
_KNOWN_MODULES = ("builtins", "cmath", "llvmlite", "math", "numba", "numpy", "operator")

_PLAIN = (bool, int, float, complex, str, bytes, type(None), type(Ellipsis))

#: Files of `jit` that no compiled code depends on: they run before or after compilation.
_HOST_FILES = frozenset(
    ["__init__.py", "cache.py", "constants.py", "copies.py", "fingerprint.py"]
    + ["from_source.py", "signatures.py", "compile_events.py", "compile_lock.py"]
    + ["ready_kernels.py", "threads.py", "user_loops.py", "warm.py"]
)

_CUDA_ROOM = "raystream.jit.cuda."

_HASH = re.compile("[0-9a-f]{32}")

_LOAD_GLOBAL, _LOAD_CONST = opmap["LOAD_GLOBAL"], opmap["LOAD_CONST"]
_EXTENDED_ARG = opmap["EXTENDED_ARG"]
_LOAD_ATTRIBUTE = ("LOAD_ATTR", "LOAD_METHOD")

#: In `co_flags` since Python 3.13; before, a function's first constant is its docstring or None.
_HAS_DOCSTRING = 0x4000000

#: In `co_flags` of functions (CO_NEWLOCALS).
_IS_FUNCTION = 0x2


class _UnknownError(Exception):
    """Something whose changes cannot be detected."""


def fingerprint(function: Callable[..., Any]) -> str | None:
    """Hash a function with everything that its names refer to.

    Parameters
    ----------
    function : callable
        A Python function, or one compiled by Numba.

    Returns
    -------
    str or None
        32 hexadecimal digits; None if it uses something whose changes cannot be detected, such
        as a class, an instance, or a module other than NumPy, ``math`` and raystream's.

    Notes
    -----
    The names of raystream's own functions are resolved once per process; Numba, too, treats
    globals as constants.
    """
    try:
        text = _READER.describe(function)
    except (_UnknownError, ValueError):  # ValueError: a closure's variable is not set yet
        return None
    return _digest(f"{generator_hash()} {text}")


def type_name(type_: Any) -> str | None:
    """Name a Numba type with everything that its code depends on.

    Numba's own names leave out the fields and modules of named tuples, and the code of functions.

    Parameters
    ----------
    type_ : numba type
        Type of an argument.

    Returns
    -------
    str or None
        None if the type contains something whose changes cannot be detected.
    """
    try:
        return _READER.describe_type(type_)
    except (_UnknownError, ValueError):
        return None


@cache
def generator_hash() -> str:
    """Hash of what every compiled function depends on: versions, and code-generating files."""
    versions = f"{sys.version_info[:2]} {numba.__version__} {llvmlite.__version__} {_version(np)}"
    return _digest(f"{versions} {_folder_hash('jit')} {_folder_hash('jit/simd')}")


def _version(module: ModuleType) -> str:
    """A module's version: of NumPy the first two numbers, since Numba looks at no more."""
    version = str(getattr(module, "__version__", ""))
    is_numpy = module.__name__.partition(".")[0] == "numpy"
    return ".".join(version.split(".")[:2]) if is_numpy else version


@cache
def cuda_generator_hash() -> str:
    """Hash of the files that generate code for CUDA only."""
    return _folder_hash("jit/cuda")


def _folder_hash(folder: str) -> str:
    """Hash of the code in a folder's files, kept on disk, since parsing takes up to 0.3 s."""
    files = [f for f in sorted((_PACKAGE / folder).glob("*.py")) if f.name not in _HOST_FILES]
    raw = hashlib.sha256(f"{sys.version_info[:2]} {len(files)}".encode())
    for file in files:
        raw.update(hashlib.sha256(file.read_bytes()).digest() + file.name.encode())
    name = f"sources-{raw.hexdigest()[:32]}.txt"
    kept = kernel_folder() / name if is_private(kernel_folder()) else None
    for file in filter(None, (kept, ready_kernels.FOLDER / name)):
        with contextlib.suppress(OSError, UnicodeDecodeError):
            found = file.read_text(encoding="ascii")
            if _HASH.fullmatch(found):
                return found
    found = _digest(" ".join(code_hash(file) for file in files))
    if kept is None:
        return found
    try:
        kept.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        with atomic_write(kept) as path:
            path.write_text(found, encoding="ascii")
    except OSError:
        pass  # read-only: each process parses the files
    return found


def code_hash(file: Path) -> str:
    """Hash a Python source file without its comments and docstrings."""
    tree = ast.parse(file.read_bytes())
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and _has_docstring(node):
            node.body[0] = ast.Pass()
    return _digest(f"{file.name} {ast.dump(tree)}")


def _has_docstring(node: ast.Module | ast.ClassDef | ast.FunctionDef) -> bool:
    first = node.body[0] if node.body else None
    return (
        isinstance(first, ast.Expr)
        and isinstance(first.value, ast.Constant)
        and isinstance(first.value.value, str)
    )


#: Larger than any depth: no cycle of calls.
_NO_CYCLE = sys.maxsize


class _Reader:
    """Describes values as text, and functions by the hash of their descriptions."""

    def __init__(self) -> None:
        self._hashes: dict[int, str] = {}
        self._alive: list[FunctionType] = []  # so that no other object gets their id
        self._open: dict[int, int] = {}  # depths of the functions being read
        self._cycle_start = _NO_CYCLE  # least depth of an open function that is called recursively

    def describe(self, value: object) -> str:
        if isinstance(value, Dispatcher):
            options = self._mapping(value.targetoptions)
            return f"compiled({options}, {self._function(value.py_func)})"
        if isinstance(value, FunctionType):
            return self._generator(value) if _makes_code(value) else self._function(value)
        if isinstance(value, type):
            return self._class(value)
        if isinstance(value, enum.Enum):
            return f"{self._class(type(value))}.{value.name}"
        if isinstance(value, tuple | list | set | frozenset):
            parts = [self.describe(part) for part in value]
            if isinstance(value, set | frozenset):
                parts.sort()
            return f"{self._class(type(value))}({', '.join(parts)})"
        if isinstance(value, np.ndarray):
            if value.dtype.hasobject:
                raise _UnknownError
            digest = hashlib.sha256(value.tobytes()).hexdigest()
            return f"array({value.dtype.descr}, {value.shape}, {digest})"
        return self._leaf(value)

    def describe_type(self, type_: Any) -> str:
        if isinstance(type_, types.Dispatcher):
            return f"function {self.describe(type_.dispatcher)}"
        if isinstance(type_, types.BaseNamedTuple):
            members = [self.describe_type(member) for member in type_.types]
            return f"{self._class(type_.instance_class)}({', '.join(members)})"
        if isinstance(type_, types.NamedTupleClass):
            return f"class {self._class(type_.instance_class)}"
        if isinstance(type_, types.EnumMember):
            return f"member of {self._class(type_.instance_class)} {type_.dtype}"
        if isinstance(type_, types.BaseTuple):
            return f"({', '.join(self.describe_type(member) for member in type_.types)},)"
        if isinstance(type_, types.Optional):
            return f"optional {self.describe_type(type_.type)}"
        name = str(type_)
        if " at 0x" in name:  # an object's address, which changes in each process
            raise _UnknownError
        return name

    def _leaf(self, value: object) -> str:
        if isinstance(value, np.generic):
            return f"{value.dtype.descr} {value.tobytes().hex()}"
        if type(value) in _PLAIN:
            return f"{type(value).__name__} {value!r}"
        if isinstance(value, CodeType):
            return self._code(value)
        if isinstance(value, np.dtype):
            return f"dtype {value.descr} {value.itemsize}"
        if isinstance(value, types.Type):
            return f"type {self.describe_type(value)}"
        if isinstance(value, ir.Type):
            return f"LLVM's type {value}"
        if isinstance(value, ModuleType):
            return self._module(value)
        if isinstance(value, BuiltinFunctionType | np.ufunc):
            return f"built-in {getattr(value, '__module__', None)}.{value.__name__}"
        if isinstance(value, _Intrinsic):
            return f"intrinsic {self.describe(value._defn)}"
        raise _UnknownError

    def _class(self, value: type) -> str:
        if _makes_code(value):
            return self._generator(value)
        name = f"{value.__module__}.{value.__qualname__}"
        fields = getattr(value, "_fields", None)
        if fields is not None and issubclass(value, tuple):
            defaults = self._mapping(getattr(value, "_field_defaults", {}))
            return f"named tuple {name}{fields} {defaults}"
        if issubclass(value, enum.Enum):
            return f"enum {name} {self._mapping({m.name: m.value for m in value})}"
        if _root(value) in _KNOWN_MODULES:
            return f"class {name}"
        raise _UnknownError

    def _generator(self, value: Any) -> str:
        """Describe code that runs at compile time by name and closure: its file is hashed whole."""
        cells = [
            self.describe(cell.cell_contents) for cell in getattr(value, "__closure__", None) or ()
        ]
        files = cuda_generator_hash() if value.__module__.startswith(_CUDA_ROOM) else ""
        return f"generator {value.__module__}.{value.__qualname__} {cells} {files}"

    def _mapping(self, value: dict[str, Any]) -> str:
        return ", ".join(f"{key}={self.describe(part)}" for key, part in sorted(value.items()))

    def _module(self, module: ModuleType) -> str:
        root = module.__name__.partition(".")[0]
        if root in (*_KNOWN_MODULES, "raystream"):  # what is used of ours is read by `_globals`
            return f"module {module.__name__} {_version(module)}"
        raise _UnknownError

    def _function(self, function: FunctionType) -> str:
        place = id(function)
        if place in self._hashes:
            return self._hashes[place]
        if place in self._open:  # it calls itself, perhaps through others
            levels = len(self._open) - self._open[place]
            if levels > 1:
                self._cycle_start = min(self._cycle_start, self._open[place])
            return f"function {levels} levels up"
        if _root(function) in _KNOWN_MODULES:
            return f"function {function.__module__}.{function.__qualname__}"
        depth = self._open[place] = len(self._open)
        outer_start, self._cycle_start = self._cycle_start, _NO_CYCLE
        try:
            digest = _digest(self._text(function))
            # The globals of users' functions may change; and in a cycle of calls the text
            # depends on the function read first.
            if _root(function) == "raystream" and self._cycle_start == _NO_CYCLE:
                self._hashes[place] = digest
                self._alive.append(function)
        finally:
            del self._open[place]
            inner_start = self._cycle_start if self._cycle_start < depth else _NO_CYCLE
            self._cycle_start = min(outer_start, inner_start)
        return digest

    def _text(self, function: FunctionType) -> str:
        cells = [self.describe(cell.cell_contents) for cell in function.__closure__ or ()]
        defaults = [self.describe(value) for value in function.__defaults__ or ()]
        more = self._mapping(function.__kwdefaults__ or {})
        code = self._code(function.__code__)
        return f"{code} {cells} {defaults} {more} {self._globals(function)}"

    def _globals(self, function: FunctionType) -> list[str]:
        used = []
        for name in sorted(_global_names(function.__code__)):
            if name not in function.__globals__:
                if not hasattr(builtins, name):
                    raise _UnknownError
                used.append(f"{name} built-in")
                continue
            value = function.__globals__[name]
            if isinstance(value, ModuleType) and _is_ours(value):
                used += sorted(set(self._read_of(function.__code__, name, value)))
            else:
                used.append(f"{name} {self.describe(value)}")
        return used

    def _read_of(self, code: CodeType, name: str, module: ModuleType) -> Iterator[str]:
        """Describe the attributes of a raystream module that code, and code inside it, reads.

        Taken from the code rather than the module: the package imports names when they are read.
        """
        steps = [step for step in dis.get_instructions(code) if step.opname != "EXTENDED_ARG"]
        for place, step in enumerate(steps):
            if step.opname != "LOAD_GLOBAL" or step.argval != name:
                continue
            path = name
            value: Any = module
            for after in steps[place + 1 :]:
                if not (isinstance(value, ModuleType) and _is_ours(value)):
                    break
                if after.opname not in _LOAD_ATTRIBUTE or not hasattr(value, after.argval):
                    raise _UnknownError  # the module itself is passed on
                path, value = f"{path}.{after.argval}", getattr(value, after.argval)
            yield f"{path} {self.describe(value)}"
        for inner in _inner(code):
            yield from self._read_of(inner, name, module)

    def _code(self, code: CodeType) -> str:
        constants = [self.describe(constant) for constant in _constants(code)]
        names = (code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars)
        arguments = (code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount)
        table, flags = code.co_exceptiontable.hex(), code.co_flags & ~_HAS_DOCSTRING
        return f"code {code.co_code.hex()} {table} {names} {arguments} {flags} {constants}"


#: Shared, so that each function is read once per process.
_READER = _Reader()


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:32]


def _root(value: Any) -> str:
    return str(value.__module__).partition(".")[0]


def _makes_code(value: Any) -> bool:
    """Whether a function or class runs at compile time, so that its file is hashed whole."""
    module = str(value.__module__)
    file = module.rpartition(".")[2] + ".py"
    return module.startswith("raystream.jit.") and file not in _HOST_FILES


def _is_ours(module: ModuleType) -> bool:
    return module.__name__.partition(".")[0] == "raystream"


def _constants(code: CodeType) -> list[Any]:
    """Constants of the code, with None in place of a docstring."""
    constants = list(code.co_consts)
    if constants and isinstance(constants[0], str) and code.co_flags & _IS_FUNCTION:
        may_be_docstring = sys.version_info < (3, 13) or code.co_flags & _HAS_DOCSTRING
        if may_be_docstring and 0 not in _operands(code, _LOAD_CONST):  # code may load it, too
            constants[0] = None
    return constants


def _operands(code: CodeType, operation: int) -> Iterable[int]:
    """Operands of all instructions with an opcode; `dis` takes ten times as long."""
    raw, extended = code.co_code, 0
    for i in range(0, len(raw), 2):
        if raw[i] == _EXTENDED_ARG:
            extended = (extended | raw[i + 1]) << 8
            continue
        if raw[i] == operation:
            yield raw[i + 1] | extended
        extended = 0


def _global_names(code: CodeType) -> set[str]:
    """Global names that the code, and code inside it, reads."""
    names = {code.co_names[operand >> 1] for operand in _operands(code, _LOAD_GLOBAL)}
    return names.union(*map(_global_names, _inner(code)))


def _inner(code: CodeType) -> list[CodeType]:
    return [constant for constant in code.co_consts if isinstance(constant, CodeType)]
