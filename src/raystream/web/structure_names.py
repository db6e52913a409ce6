"""The names of a page's structures, of which several may be of one kind."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from raystream.structures import StructureOptions


def structure_names(structures: Sequence[StructureOptions]) -> list[str]:
    """The names of structures: of several of one kind, also the options given.

    Parameters
    ----------
    structures : sequence of StructureOptions

    Returns
    -------
    list of str
        As ``raystream export --structure`` takes them.

    Raises
    ------
    ValueError
        If two are equal.

    Examples
    --------
    >>> import raystream as rs
    >>> structure_names([rs.KdTree(), rs.KdTree(traversal="restart"), rs.Grid(resolution=8)])
    ['kdtree', 'kdtree:traversal=restart', 'grid']
    """
    kinds = [one.name for one in structures]
    names = [one.name if kinds.count(one.name) == 1 else _with_options(one) for one in structures]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"structures: expected different ones, got {name!r} twice")
    return names


def _with_options(structure: StructureOptions) -> str:
    given = ",".join(f"{name}={_text(value)}" for name, value in structure.given().items())
    return f"{structure.name}:{given}" if given else structure.name


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, separators=(",", ":"))
