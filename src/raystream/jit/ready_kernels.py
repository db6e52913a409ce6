"""Kernels that come ready with a wheel, compiled for a level of x86-64 and not for one processor.

``.ci/wheel --ready`` compiles what ``kernels.json`` lists and adds the files to the wheel; a source
tree and other wheels have none, and then kernels are compiled when they are first called. The
levels are those of the x86-64 psABI (version 1.0, table 3.1), as all of a level's processors run
its code. Code of level v2 would take up to ten times as long, and is not made (decision 0055).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType

#: In a wheel that has ready kernels: a folder for each level, and hashes of sources, as
#: `fingerprint` keeps them.
FOLDER = Path(__file__).with_name("ready")

_V3 = (
    "+cmov,+cx8,+fxsr,+mmx,+sse,+sse2,+cx16,+sahf,+popcnt,+sse3,+sse4.1,+sse4.2,+ssse3,"
    "+avx,+avx2,+bmi,+bmi2,+f16c,+fma,+lzcnt,+movbe,+xsave"
)

#: Features of the levels as LLVM names them, the highest level first.
LEVELS: Mapping[str, str] = MappingProxyType(
    {"x86-64-v4": f"{_V3},+avx512f,+avx512bw,+avx512cd,+avx512dq,+avx512vl", "x86-64-v3": _V3}
)


@cache
def machines_of(
    machine: tuple[str, str, str],
) -> tuple[tuple[Path, tuple[str, str, str]], ...]:
    """Folders whose kernels a machine can run, the best first.

    Parameters
    ----------
    machine : tuple of str
        Platform, processor and features, as LLVM names them (Numba's ``magic_tuple``).

    Returns
    -------
    tuple of (Path, tuple)
        Each with the machine that its kernels were compiled for.
    """
    return tuple(_fitting(machine))


def _fitting(machine: tuple[str, str, str]) -> Iterator[tuple[Path, tuple[str, str, str]]]:
    platform, _, features = machine
    has = set(features.split(","))
    for level, needs in LEVELS.items():
        folder = FOLDER / level
        if has.issuperset(needs.split(",")) and folder.is_dir():
            yield folder, (platform, level, needs)
