"""A copy of the package with a kernel of its own, for tests that edit it or its cache."""

import shutil
from pathlib import Path

import raystream

#: A kernel in one file that calls a function in another.
CALLEE = """
from raystream.jit.cpu import device

@device
def answer(x):
    return x + 1
"""
CALLER = """
from raystream.jit.cpu import kernel
from raystream.kernels.callee import answer

@kernel
def ask(x):
    return answer(x)
"""

#: Runs it; says how often it came from the cache, and how often it was compiled.
PROGRAM = """
from raystream.kernels.caller import ask
print(ask(1))
print(sum(ask.stats.cache_hits.values()), sum(ask.stats.cache_misses.values()))
"""


def copy_package(folder: Path) -> Path:
    """Copy the package into a folder, with the kernel and the function; its path."""
    package = folder / "raystream"
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(Path(raystream.__file__).parent, package, ignore=ignored)
    (package / "kernels" / "callee.py").write_text(CALLEE)
    (package / "kernels" / "caller.py").write_text(CALLER)
    return package
