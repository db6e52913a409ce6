"""How large the code is, what it writes several times, and how many files a query passes through.

    python benchmarks/code_size.py                     the working tree
    python benchmarks/code_size.py --commit c397146b   another commit, read by git archive

Prints, of the tree alone and with the standard library alone: the number of lines of each
subpackage; the loops, tests, rules and loaders that are written several times, which
`code_size.toml` lists; functions with more than nine parameters; circles of files; the places
that name a kind of query, which a new kind has to change; and tests of the class of a geometry. Of
the working tree, by running a query: the files that a first hit passes through, from
`Tracer.first_hit` to the triangle test.
"""

import argparse
import ast
import io
import re
import subprocess
import sys
import tarfile
import tomllib
from collections import Counter
from pathlib import Path
from types import FunctionType

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "raystream"
LIST = Path(__file__).with_suffix(".toml")
MOST_PARAMETERS = 9

#: Classes of geometry, and how often code may ask for one of them.
STORES = re.compile(r"\b(Store|Triangles|Primitives|Instanced\w+|Float64\w+|\w*Geometry)\b")
MOST_STORE_TESTS = 8

#: The rooms in which wide functions are limited: all that a query passes through.
ENGINE = (
    "core", "jit", "kernels", "geometry", "structures", "streams", "programs", "machines", "tracer",
    "tracer.py", "instances", "float64", "primitives", "stepper", "cuda", "graphics",
)  # fmt: skip

#: Not counted as passed, since they are everywhere: what kernels are written with and run by.
TOOLS = ("jit/",)


# ---- Trees of files: path below the package, and text.


def files_now():
    """All files of the working tree."""
    paths = [path for path in sorted(SOURCE.rglob("*")) if path.suffix in (".py", ".wgsl")]
    return {path.relative_to(SOURCE).as_posix(): path.read_text("utf-8") for path in paths}


def files_at(commit):
    """All files of a commit."""
    command = ["git", "archive", commit, "--", "src/raystream"]
    packed = subprocess.run(command, cwd=ROOT, check=True, capture_output=True).stdout
    with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
        return {
            one.name.removeprefix("src/raystream/"): archive.extractfile(one).read().decode()
            for one in archive
            if one.isfile() and one.name.endswith((".py", ".wgsl"))
        }


def modules(files):
    """Path and syntax tree of every module."""
    return {path: ast.parse(text) for path, text in files.items() if path.endswith(".py")}


# ---- What is written several times.


def is_there(files, trees, entry, moved=None):
    """Whether an entry of the list holds in a tree of files, some of which were moved since."""
    at, unless = (entry["at"], entry["without"]) if isinstance(entry, dict) else (entry, None)
    path, name = at.split()
    path = path if path in files else (moved or {}).get(path, path)
    if path not in files:
        return False
    if path.endswith(".wgsl"):
        return re.search(rf"^fn {name}\(", files[path], re.MULTILINE) is not None
    node = trees[path]
    for part in name.split("."):
        node = next((one for one in ast.walk(node) if is_named(one, part)), None)
        if node is None:
            return False
    return all(getattr(one, "id", None) != unless for one in ast.walk(node)) or unless is None


def is_named(node, name):
    """Whether a node defines a function or class of this name, or assigns a made one to it."""
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        return node.name == name
    return isinstance(node, ast.Assign) and name in map(ast.unparse, node.targets)


def repeated(files, trees, kinds):
    """Each kind with its entries that hold in a tree, by how they were found."""
    moved = kinds.get("moved", {})
    for kind in (kinds[name] for name in kinds if name != "moved"):
        yield (
            kind,
            {
                how: [one for one in kind.get(how, ()) if is_there(files, trees, one, moved)]
                for how in ("listed", "found", "apart")
            },
        )


def print_repeated(files, trees, kinds, shows_all):
    """Print a row for each kind; and its rule and entries, if all is to be shown."""
    heads = "listed", "review", "found", "both", "limit", "apart"
    print(f"{'written several times':44}", *(f"{head:>6}" for head in heads))
    for kind, there in repeated(files, trees, kinds):
        listed, found, apart = map(len, there.values())
        counts = listed, kind["reviewed"], found, listed + found, kind["at_most"], apart
        print(f"{kind['title']:44}", *(f"{count:6}" for count in counts))
        if shows_all:
            print("", *kind["rule"].strip().split("\n"), "", sep="\n    ")
            for how, entries in there.items():
                for entry in entries:
                    print(f"    {how:8}", entry["at"] if isinstance(entry, dict) else entry)
            print()
    print()


def long_signatures(trees):
    """Functions with many parameters: path, name, and number of parameters without self."""
    for path, tree in trees.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                given = node.args.posonlyargs + node.args.args + node.args.kwonlyargs
                count = sum(one.arg not in ("self", "cls") for one in given)
                if count > MOST_PARAMETERS:
                    yield path, f"{path}:{node.lineno} {node.name}", count


# ---- Circles of files.


def imports(trees, at_runtime, package="raystream"):
    """For each module the modules that it imports.

    All imports count, also those in functions; those for type checkers only, unless `at_runtime`.
    A package stands for its `__init__` only if a name of that is imported.
    """
    names = {}
    for path in trees:
        parts = path.removesuffix(".py").split("/")
        parts = parts[:-1] if parts[-1] == "__init__" else parts
        names[".".join([package, *parts])] = path
    found = {path: set() for path in trees}
    for name, path in names.items():
        own = name if path.endswith("__init__.py") else name.rpartition(".")[0]
        for imported in _imported(trees[path], own, at_runtime):
            target = imported if imported in names else imported.rpartition(".")[0]
            if target in names and target != name:
                found[path].add(names[target])
    return found


def _imported(node, package, at_runtime):
    """Dotted names that a module imports, of modules or in modules."""
    if isinstance(node, ast.If) and at_runtime and ast.unparse(node.test) == "TYPE_CHECKING":
        inner = node.orelse
    elif isinstance(node, ast.Import):
        yield from (one.name for one in node.names)
        return
    elif isinstance(node, ast.ImportFrom):
        parents = package.split(".")
        parents = parents[: len(parents) - node.level + 1] if node.level else []
        base = ".".join([*parents, node.module] if node.module else parents)
        yield from (f"{base}.{one.name}" for one in node.names)
        return
    else:
        inner = ast.iter_child_nodes(node)
    for one in inner:
        yield from _imported(one, package, at_runtime)


def circles(graph):
    """Groups of files that import each other, directly or through others: Tarjan's algorithm."""
    order, low, stack, found = {}, {}, [], []

    def visit(one):
        order[one] = low[one] = len(order)
        stack.append(one)
        for other in sorted(graph[one]):
            if other not in order:
                visit(other)
                low[one] = min(low[one], low[other])
            elif other in stack:
                low[one] = min(low[one], order[other])
        if low[one] == order[one]:
            at = stack.index(one)
            if len(stack) > at + 1:
                found.append(sorted(stack[at:]))
            del stack[at:]

    for one in sorted(graph):
        if one not in order:
            visit(one)
    return sorted(found)


def print_circles(trees):
    """Print the circles of all imports, and how many of them exist at run time."""
    running = circles(imports(trees, at_runtime=True))
    found = circles(imports(trees, at_runtime=False))
    print(f"{len(found)} circles of files, {len(running)} at run time")
    print(*(f"  {' '.join(one)}" for one in found), sep="\n")


# ---- Files that a query passes through.


def reached(function, files):
    """Collect the files of the functions that a compiled function may call."""
    from numba.core.dispatcher import Dispatcher

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
    import numpy as np
    from numba.core.dispatcher import Dispatcher

    import raystream as rs

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


def print_files_passed():
    """Print them for two structures."""
    for label, options in (("bvh", {"kernel": "wavefront"}), ("kdtree", {"structure": "kdtree"})):
        files = files_passed(**options)
        print(f"\n{len(files)} files in a first hit, {label}:")
        print(*(f"  {name}" for name in files), sep="\n")


def places_of(kind, files):
    """Places where a kind of query is named."""
    for path, text in files.items():
        for number, line in enumerate(text.splitlines(), 1):
            if f"Kind.{kind}" in line:
                yield f"{path}:{number}"


def store_tests(trees):
    """Places that ask of which class a geometry is, which a declaration could say."""
    for path, tree in trees.items():
        for node in ast.walk(tree):
            is_test = isinstance(node, ast.Call) and ast.unparse(node.func) == "isinstance"
            if is_test and len(node.args) == 2 and STORES.search(ast.unparse(node.args[1])):
                yield f"{path}:{node.lineno}"


def main(given=None):
    """Print all of these."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--commit", help="read this commit, not the working tree")
    parser.add_argument("--entries", action="store_true", help="print rules and entries too")
    options = parser.parse_args(given)
    files = files_at(options.commit) if options.commit else files_now()
    trees = modules(files)

    lines = Counter()
    for path in trees:
        lines[path.partition("/")[0]] += len(files[path].splitlines())
    print(*(f"{room:20} {count:7,}" for room, count in lines.most_common()), sep="\n")
    print(f"{'all of src':20} {lines.total():7,}\n")

    kinds = tomllib.loads(LIST.read_text("utf-8"))
    print_repeated(files, trees, kinds, options.entries)

    signatures = sorted(long_signatures(trees), key=lambda one: -one[2])
    inside = sum(path.partition("/")[0] in ENGINE for path, _, _ in signatures)
    print(f"{len(signatures)} functions with more than {MOST_PARAMETERS} parameters")
    print(f"{inside} of them in the engine's rooms")
    print(*(f"  {count:3} {name}" for _, name, count in signatures), sep="\n")

    print()
    print_circles(trees)
    places = list(places_of("COUNT_HITS", files))
    file_count = len({place.partition(":")[0] for place in places})
    print(f"\n{len(places)} lines name Kind.COUNT_HITS, in {file_count} files")
    print(*(f"  {place}" for place in places), sep="\n")
    tests = list(store_tests(trees))
    print(f"\n{len(tests)} isinstance tests on stores; at most {MOST_STORE_TESTS}")
    print(*(f"  {place}" for place in tests), sep="\n")
    if not options.commit:
        print_files_passed()


if __name__ == "__main__":
    main()
