"""Shader sources: WGSL files that include each other, put together."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from importlib.resources import files

__all__ = ["shader_source"]

#: A line that is replaced by a file of the same folder, the first time that it is asked for.
_INCLUDE = re.compile(r'^//! include "([a-z0-9_/]+\.wgsl)"$', re.MULTILINE)


@cache
def _text_of(name: str) -> str:
    return (files("raystream.graphics") / "shaders" / name).read_text(encoding="utf-8")


def shader_source(*names: str, instead: Mapping[str, str] | None = None) -> str:
    """Put shader files together.

    Parameters
    ----------
    *names : str
        Files of the folder ``shaders``. Each file is included once, where it is first asked for:
        WGSL lets functions call what is declared after them.
    instead : mapping of str to str, optional
        Files to be taken in place of others, by the name of these.

    Returns
    -------
    str
        With a comment at the beginning of each file, so that line numbers can be found again.
    """
    seen: set[str] = set()
    replaced = instead or {}

    def included(name: str) -> str:
        name = replaced.get(name, name)
        if name in seen:
            return ""
        seen.add(name)
        text = _INCLUDE.sub(lambda match: included(match.group(1)), _text_of(name))
        return f"// {name}\n{text}"

    return "\n".join(included(name) for name in names)
