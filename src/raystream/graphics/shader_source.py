"""Shader sources, assembled from WGSL files that include each other."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.resources import files

#: A line that is replaced by a file of the folder, unless it was included before.
_INCLUDE = re.compile(r'^//! include "([a-z0-9_/]+\.wgsl)"$', re.MULTILINE)


#: The bind group of a structure's arrays as its files have it; and of a renderer's arrays in files
#: of this folder. A program with both moves the former.
TREE_GROUP, _RENDERING = 1, "rendering/"


@cache
def _text_of(name: str) -> str:
    return (files("raystream.graphics") / "shaders" / name).read_text(encoding="utf-8")


def shader_source(
    *names: str, instead: Mapping[str, str] | None = None, tree_group: int = TREE_GROUP
) -> str:
    """Assemble shader files.

    Parameters
    ----------
    *names : str
        Files of the folder ``shaders``. Each one is included once, at its first include: in WGSL,
        declarations may follow their use.
    instead : mapping of str to str, optional
        Files that replace others, by the names of these.
    tree_group : int
        The bind group of a structure's arrays.

    Returns
    -------
    str
        With the name of each file in a comment before it, to locate errors.
    """
    seen: set[str] = set()
    replaced = instead or {}

    def included(name: str) -> str:
        name = replaced.get(name, name)
        if name in seen:
            return ""
        seen.add(name)
        text = _text_of(name)
        if not name.startswith(_RENDERING):
            text = text.replace(f"@group({TREE_GROUP})", f"@group({tree_group})")
        text = _INCLUDE.sub(lambda match: included(match.group(1)), text)
        return f"// {name}\n{text}"

    return "\n".join(included(name) for name in names)


def shader_files(names: Iterable[str]) -> dict[str, str]:
    """Shader files and all that they include, by name."""
    found: dict[str, str] = {}
    left = sorted(names)
    while left:
        name = left.pop()
        if name not in found:
            found[name] = _text_of(name)
            left += _INCLUDE.findall(found[name])
    return found


def with_early_test(source: str, entry: str) -> str:
    """A source whose fragment program runs only where the stencil test passes.

    By default the test comes later if a program writes buffers. Needs `OpenDevice.has_early_test`.
    """
    begin = f"@fragment\nfn {entry}("
    return source.replace(begin, f"@early_depth_test(force)\n{begin}")
