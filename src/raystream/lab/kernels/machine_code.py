"""Counting the machine's instructions in an assembly text."""

from __future__ import annotations

import re
from collections import Counter
from typing import NamedTuple

__all__ = ["MachineCounts", "count_machine_code", "listing"]


class MachineCounts(NamedTuple):
    """Instructions of the processor that this runs on.

    Attributes
    ----------
    total : int
    by_class : dict of str to int
        ``"branches"`` (conditional), ``"jumps"``, ``"calls"``, ``"moves"`` (with loads and
        stores of their own), ``"comparisons"``, ``"lanes"`` (moves within vectors),
        ``"floating"`` (with conversions), ``"integer"`` and ``"other"``. Classes are known for
        x86-64; on other processors all but `total` and `by_name` is ``"other"``.
    by_name : dict of str to int
        By mnemonic.
    """

    total: int
    by_class: dict[str, int]
    by_name: dict[str, int]


_RULES = {
    "calls": ["call", "ret"],
    "jumps": ["jmp"],
    "branches": ["j[a-z]+"],
    "comparisons": [
        "cmp",
        "test",
        "v?u?comis[sd]",
        "v?p?cmp",
        "set",
        "cmov",
        "v?p?blend",
        "bt[lq]?$",
    ],
    "lanes": [
        *("v?p?shuf", "v?p?unpck", "v?p?perm", "v?p?insert", "v?p?extract", "v?p?broadcast"),
        *("v?mov[lh]+ps", "vmov[sd]l?dup"),
    ],
    "moves": ["v?mov", "lea", "push", "pop[qlw]", "kmov", "vpmovm", "v?p?gather"],
    "floating": [
        "v?(add|sub|mul|div|min|max|sqrt|round|rndscale|hadd|dp)[a-z0-9]*[sp][sd]$",
        *("v?(and|andn|or|xor)p[sd]$", "vfn?m(add|sub)", "v?cvt"),
    ],
    "integer": [
        *("add", "sub", "i?mul", "i?div", "sh[lr]", "sa[rl]", "ro[lr]", "and", "or", "xor", "not"),
        *("neg", "inc", "dec", "adc", "sbb", "tzcnt", "lzcnt", "popcnt", "bls", "bs[fr]", "bextr"),
        *("c[dqwl]t?[dqo]", "v?p(add|sub|mul|and|or|xor|sll|srl|sra|min|max|tern)", "k[a-z]+"),
        "vpmov",
    ],
}
_CLASSES = {name: re.compile("|".join(rules)) for name, rules in _RULES.items()}


def listing(assembly: str, name: str) -> list[str]:
    """The instructions of a function in an assembly text, one a line.

    Raises
    ------
    ValueError
        If it is not there.
    """
    lines = iter(assembly.splitlines())
    for line in lines:
        if line.split("#")[0].strip().strip('"') in (f"{name}:", f'{name}":'):
            break
    else:
        raise ValueError(f"the assembly has no function {name!r}")
    found = []
    for line in lines:
        if line.startswith((".Lfunc_end", "Lfunc_end")) or line.startswith("\t.size"):
            break
        if line.startswith("\t") and not line.startswith("\t."):
            found.append(line.strip())
    return found


def count_machine_code(assembly: str, name: str) -> MachineCounts:
    """Count the instructions of a function in an assembly text.

    Parameters
    ----------
    assembly : str
        As LLVM writes it.
    name : str
        What the compiler calls it.
    """
    names = Counter(line.split()[0] for line in listing(assembly, name))
    classes: Counter[str] = Counter()
    for mnemonic, count in names.items():
        classes[_class_of(mnemonic)] += count
    return MachineCounts(sum(names.values()), dict(classes), dict(names))


def _class_of(mnemonic: str) -> str:
    for name, rule in _CLASSES.items():
        if rule.match(mnemonic):
            return name
    return "other"
