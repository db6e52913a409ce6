"""The values published in the papers, read from a single data file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple


class Published(NamedTuple):
    """The values from one place of a paper.

    Attributes
    ----------
    paper : str
        The name under which docstrings cite it.
    place : str
        Table, figure or section.
    values : Any
        As printed; table rows are mappings from column names.
    """

    paper: str
    place: str
    values: Any

    @property
    def source(self) -> str:
        """Paper and place as text."""
        return f"{self.paper}, {self.place}"


@cache
def _file() -> Mapping[str, Any]:
    text = files("raystream_lab").joinpath("published.json").read_text(encoding="utf-8")
    return json.loads(text)


def paper_name(paper: str) -> str:
    """The name by which a paper is cited."""
    return str(_file()[paper]["name"])


def paper_title(paper: str) -> str:
    """A paper's title."""
    return str(_file()[paper]["title"])


def paper_reference(paper: str) -> str:
    """A paper's authors, title, venue and, if it has one, its DOI, as Markdown."""
    entry = _file()[paper]
    doi = f", <https://doi.org/{entry['doi']}>" if "doi" in entry else ""
    return f"{entry['authors']}: {entry['title']}, {entry['venue']}{doi}"


def published(paper: str, place: str) -> Published:
    """Look up published values.

    Parameters
    ----------
    paper : {"purcell", "foley", "rayforce", "christen"}
    place : str
        Such as ``"table 1"``; see ``published.json``.

    Raises
    ------
    KeyError
        If the place is unknown.
    """
    entry = _file()[paper][place]
    values, columns = entry["values"], entry.get("columns")
    return Published(
        paper_name(paper), entry["place"], values if columns is None else _rows(values, columns)
    )


def _rows(values: Any, columns: list[str]) -> Any:
    """Turn lists of column values into mappings, at any depth."""
    if isinstance(values, list):
        return dict(zip(columns, values, strict=True))
    return {name: _rows(inner, columns) for name, inner in values.items()}
