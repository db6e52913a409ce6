"""Published values: read from one data file, and from nowhere else."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple

__all__ = ["Published", "paper_name", "published"]


class Published(NamedTuple):
    """What a paper printed in one place.

    Attributes
    ----------
    paper : str
        By the name under which docstrings cite it.
    place : str
        Table, figure or section.
    values : Any
        As printed; rows of tables are mappings from a column's name.
    """

    paper: str
    place: str
    values: Any

    @property
    def source(self) -> str:
        """Paper and place, for people."""
        return f"{self.paper}, {self.place}"


@cache
def _file() -> Mapping[str, Any]:
    text = files("raystream.lab").joinpath("published.json").read_text(encoding="utf-8")
    return json.loads(text)


def paper_name(paper: str) -> str:
    """The name under which a paper is cited."""
    return str(_file()[paper]["name"])


def published(paper: str, place: str) -> Published:
    """Look up what a paper printed.

    Parameters
    ----------
    paper : {"purcell", "foley", "rayforce", "christen"}
    place : str
        Such as ``"table 1"``; see ``published.json``.

    Raises
    ------
    KeyError
        If there is no such place.
    """
    entry = _file()[paper][place]
    values, columns = entry["values"], entry.get("columns")
    return Published(
        paper_name(paper), entry["place"], values if columns is None else _rows(values, columns)
    )


def _rows(values: Any, columns: list[str]) -> Any:
    """Lists in the order of columns as mappings, at any depth."""
    if isinstance(values, list):
        return dict(zip(columns, values, strict=True))
    return {name: _rows(inner, columns) for name, inner in values.items()}
