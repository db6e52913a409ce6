"""Import what an install line has installed; install_lines runs this in the new environment.

    python .ci/install_smoke.py EXTRA...

raystream, the packages that each extra names, for "lab" the lab, and for "docs" Sphinx's
extensions and all that the examples import.
"""

from __future__ import annotations

import ast
import importlib
import re
import runpy
import sys
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, distribution, packages_distributions, requires
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def packages_of(extra: str) -> Iterator[str]:
    """The distributions that an extra of raystream names, and those of its own extras."""
    for line in requires("raystream") or ():
        requirement, _, marker = line.partition(";")
        if f"extra == '{extra}'" not in marker.replace('"', "'"):
            continue
        name, inner = re.fullmatch(r"([\w.-]+)(?:\[([\w,-]+)\])?.*", requirement.strip()).groups()
        if name != "raystream":
            yield name
        for one in (inner or "").split(",") if name == "raystream" else ():
            yield from packages_of(one)


def import_package(name: str) -> None:
    """Import the modules of a distribution, unless pip has left it out on this platform."""
    try:
        name = distribution(name).name
    except PackageNotFoundError:
        return
    for module, owners in packages_distributions().items():
        if name in owners and module.isidentifier() and not module.startswith("_"):
            importlib.import_module(module)


def imports_of(example: Path) -> Iterator[str]:
    """Modules that an example imports, but for those it can do without."""
    waiting: list[ast.AST] = [ast.parse(example.read_text(encoding="utf-8"))]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Import):
            yield from (one.name for one in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module
        elif not isinstance(node, ast.Try):
            waiting += ast.iter_child_nodes(node)


def main(extras: list[str]) -> None:
    import raystream

    raystream.load("cornell")
    for extra in extras:
        for name in packages_of(extra):
            import_package(name)
    if "lab" in extras:
        importlib.import_module("raystream_lab")
    if "docs" in extras:
        names = runpy.run_path(str(ROOT / "docs" / "conf.py"))["extensions"]
        names += [
            name for example in (ROOT / "examples").rglob("*.py") for name in imports_of(example)
        ]
        sys.path.append(str(ROOT / "examples" / "simulation"))  # the package of an example
        for name in dict.fromkeys(names):
            importlib.import_module(name)


if __name__ == "__main__":
    main(sys.argv[1:])
