"""Count a function's instructions in an assembly listing."""

from __future__ import annotations


def count_machine_code(assembly: str, name: str) -> int:
    """Count the instructions of a function, without labels and directives.

    Parameters
    ----------
    assembly : str
        As LLVM writes it.
    name : str
        The compiler's name of the function.

    Raises
    ------
    ValueError
        If the assembly does not contain the function.
    """
    lines = iter(assembly.splitlines())
    for line in lines:
        if line.split("#")[0].strip().strip('"') in (f"{name}:", f'{name}":'):
            break
    else:
        raise ValueError(f"the assembly has no function {name!r}")
    count = 0
    for line in lines:
        if line.startswith((".Lfunc_end", "Lfunc_end", "\t.size")):
            break
        count += line.startswith("\t") and not line.startswith("\t.")
    return count
