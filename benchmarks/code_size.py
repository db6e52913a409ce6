"""How large the code is, and how many files a query passes through.

    python benchmarks/code_size.py

Prints the number of lines of each subpackage; functions with more than nine parameters; the files
that a first hit passes through, from `Tracer.first_hit` to the triangle test, with the BVH's
kernels for many rays and with those for single rays; and the places that name a kind of query,
which a new kind has to change.
"""

import argparse
import ast
import sys
from collections import Counter
from pathlib import Path
from types import FunctionType

import numpy as np
from numba.core.dispatcher import Dispatcher

import raystream as rs
from raystream.core.query import Kind

SOURCE = Path(rs.__file__).parent
MOST_PARAMETERS = 9

#: Not counted as passed, since they are everywhere: what kernels are written with and run by.
TOOLS = ("jit/",)


def modules():
    """Path and text of every module."""
    for path in sorted(SOURCE.rglob("*.py")):
        yield path.relative_to(SOURCE).as_posix(), path.read_text(encoding="utf-8")


def lines_of_rooms():
    """Lines by subpackage."""
    lines = Counter()
    for name, text in modules():
        lines[name.partition("/")[0]] += len(text.splitlines())
    return lines


def long_signatures():
    """Functions with many parameters: name and number of parameters."""
    for name, text in modules():
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef):
                given = node.args.posonlyargs + node.args.args + node.args.kwonlyargs
                count = sum(one.arg not in ("self", "cls") for one in given)
                if count > MOST_PARAMETERS:
                    yield f"{name}:{node.lineno} {node.name}", count


def reached(function, files):
    """Collect the files of the functions that a compiled function may call."""
    function = function.py_func if isinstance(function, Dispatcher) else function
    name = Path(function.__code__.co_filename)
    if not name.is_relative_to(SOURCE) or function in files:
        return
    files[function] = name.relative_to(SOURCE).as_posix()
    cells = [cell.cell_contents for cell in function.__closure__ or ()]
    values = [function.__globals__.get(used) for used in function.__code__.co_names]
    for value in cells + values:
        if isinstance(value, Dispatcher | FunctionType):
            reached(value, files)


def files_passed(**options):
    """Files of the Python functions, and of the kernels' functions, that a first hit runs."""
    tracer = rs.Tracer(rs.load("cornell"), **options)
    rays = np.full((2000, 3), [278, 273, -800.0]), [0, 0, 1]
    tracer.first_hit(*rays)
    files, kernels = set(), {}

    def note(frame, event, _argument):
        path = Path(frame.f_code.co_filename)
        if event == "call" and path.is_relative_to(SOURCE):
            files.add(path.relative_to(SOURCE).as_posix())
            for value in (*frame.f_globals.values(), *frame.f_locals.values()):
                if isinstance(value, Dispatcher):
                    launched.setdefault(path, set()).add(value)

    launched = {}
    sys.setprofile(note)
    try:
        tracer.first_hit(*rays)
    finally:
        sys.setprofile(None)
    for values in launched.values():
        for kernel in values:
            if kernel.overloads:  # it has run
                reached(kernel, kernels)
    every = files | set(kernels.values())
    return sorted(name for name in every if not name.startswith(TOOLS))


def places_of(kind):
    """Places where a kind of query is named."""
    for name, text in modules():
        for number, line in enumerate(text.splitlines(), 1):
            if f"Kind.{kind.name}" in line:
                yield f"{name}:{number}"


def main():
    """Print all of these."""
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    lines = lines_of_rooms()
    print(*(f"{room:20} {count:7,}" for room, count in lines.most_common()), sep="\n")
    print(f"{'all of src':20} {lines.total():7,}\n")
    signatures = sorted(long_signatures(), key=lambda one: -one[1])
    print(f"{len(signatures)} functions with more than {MOST_PARAMETERS} parameters")
    print(*(f"  {count:3} {name}" for name, count in signatures), sep="\n")
    for label, options in (("bvh", {"kernel": "wavefront"}), ("kdtree", {"structure": "kdtree"})):
        files = files_passed(**options)
        print(f"\n{len(files)} files in a first hit, {label}:")
        print(*(f"  {name}" for name in files), sep="\n")
    places = list(places_of(Kind.COUNT_HITS))
    file_count = len({place.partition(":")[0] for place in places})
    print(f"\n{len(places)} lines name Kind.COUNT_HITS, in {file_count} files")
    print(*(f"  {place}" for place in places), sep="\n")


if __name__ == "__main__":
    main()
