"""A directive: from a place in a paper to the code, the command, and our number beside its own.

.. code-block:: rst

   .. paper-map:: purcell

      Figure 6, section 4.1: cells that a ray visits, v
      use: ``counters=True``
      code: raystream.structures.grid.dda.step_walk
      run: raystream lab purcell --only statistics
      row: purcell-figure-6 | bunny on a floor: cells per ray (v)
      claim: v, t and s agree with Figure 6

The argument is the paper, and figures are those of its experiments. Entries are separated by an
empty line. ``row`` names a row of a table of the stored report that
compares with the paper; ``cell: TABLE | COLUMN=VALUE, ... | COLUMN | COLUMN`` the paper's figure
and ours in any table; ``claim`` a claim with its verdict, by how its text begins. ``code`` is found
in the sources, and shown with its line: what is not there, in the sources or the report, fails the
build.
"""

from __future__ import annotations

import ast
import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from sphinx.application import Sphinx

from raystream_lab.report.cell_text import cell_text

ROOT = Path(__file__).resolve().parents[2]
REPORT = ROOT / "docs" / "lab" / "cpu" / "report.json"
SOURCES = {"raystream": ROOT / "src", "raystream_lab": ROOT / "lab" / "src"}

#: The columns' headings and widths.
COLUMNS = (
    ("In the paper", 22),
    ("In raystream, and how to run it", 42),
    ("Published, and ours", 36),
)


@cache
def _report() -> dict[str, Any]:
    content: dict[str, Any] = json.loads(REPORT.read_text(encoding="utf-8"))
    return content["experiments"]


def _all(paper: str, kind: str) -> Iterator[dict[str, Any]]:
    """The tables or claims of a paper's experiments."""
    for name, experiment in _report().items():
        if name.startswith(f"{paper}-"):
            yield from experiment[kind]


def _row(paper: str, name: str, wanted: dict[str, str]) -> dict[str, Any]:
    """The row of a table with these cells."""
    for table in _all(paper, "tables"):
        if table["name"] == name:
            for row in table["rows"]:
                if all(str(row.get(column)) == value for column, value in wanted.items()):
                    return row
            raise LookupError(f"the stored report's table {name} has no row with {wanted}")
    raise LookupError(f"the stored report has no table {name}")


def _claim(paper: str, text: str) -> dict[str, Any]:
    found = [one for one in _all(paper, "claims") if one["text"].lower().startswith(text.lower())]
    if len(found) != 1:
        raise LookupError(f"the stored report has {len(found)} claims that begin with {text!r}")
    return found[0]


def _line_of(name: str) -> str:
    """The file and line that define a dotted name: ``grid/dda.py:233``."""
    parts = name.split(".")
    base = SOURCES[parts[0]]
    for k in range(len(parts), 0, -1):
        path = base.joinpath(*parts[:k]).with_suffix(".py")
        if not path.is_file():
            path = base.joinpath(*parts[:k], "__init__.py")
        if path.is_file():
            break
    else:
        raise LookupError(f"{name}: no such module")
    shown = path.relative_to(ROOT).as_posix()
    found: list[Any] = [ast.parse(path.read_text(encoding="utf-8"))]
    for part in parts[k:]:
        found = [one for one in ast.walk(found[0]) if getattr(one, "name", None) == part]
        if not found:
            raise LookupError(f"{name}: not in {shown}")
    return f"{shown}:{found[0].lineno}" if parts[k:] else shown


class _Entry:
    """One row of the map."""

    def __init__(self, paper: str, lines: list[str]) -> None:
        self._paper = paper
        self.place = lines[0]
        self.use: list[str] = []
        self.found: list[str] = []
        for line in lines[1:]:
            key, _, value = line.partition(": ")
            getattr(self, f"_add_{key}", self._unknown)(value.strip())

    @staticmethod
    def _unknown(value: str) -> None:
        raise LookupError(f"paper-map: no such field before {value!r}")

    def _add_use(self, value: str) -> None:
        self.use.append(value)

    def _add_code(self, value: str) -> None:
        self.use.append(f"``{_line_of(value)}``")

    def _add_run(self, value: str) -> None:
        self.use.append(f"``$ {value}``")

    def _add_row(self, value: str) -> None:
        name, quantity = (part.strip() for part in value.split("|"))
        row = _row(self._paper, name, {"quantity": quantity})
        theirs, ours = cell_text(row["published"]), cell_text(row["ours"])
        self.found.append(f"{quantity}: {theirs}, ours **{ours}**")

    def _add_cell(self, value: str) -> None:
        name, wanted, theirs, ours = (part.strip() for part in value.split("|"))
        cells = dict(part.strip().split("=") for part in wanted.split(","))
        row = _row(self._paper, name, cells)
        for column in (theirs, ours):
            if column not in row:
                raise LookupError(f"the stored report's table {name} has no column {column!r}")
        label = ", ".join(cells.values())
        self.found.append(f"{label}: {cell_text(row[theirs])}, ours **{cell_text(row[ours])}**")

    def _add_claim(self, value: str) -> None:
        claim = _claim(self._paper, value)
        text = claim["text"].replace("*", "\\*")
        self.found.append(f"{text[:1].upper()}{text[1:]}: **{claim['verdict']}**")

    def columns(self) -> tuple[str, ...]:
        """The text of each column."""
        return (self.place, *(" |br| ".join(cell) for cell in (self.use, self.found)))


class PaperMap(Directive):
    """See the module."""

    required_arguments: ClassVar[int] = 1
    has_content: ClassVar[bool] = True

    def run(self) -> list[nodes.Node]:
        """Write a list-table, and let reStructuredText read it."""
        entries: list[list[str]] = [[]]
        for line in self.content:
            if line.strip():
                entries[-1].append(line.strip())
            elif entries[-1]:
                entries.append([])
        lines = [
            ".. list-table::",
            "   :header-rows: 1",
            f"   :widths: {' '.join(str(width) for _, width in COLUMNS)}",
            "   :class: paper-map",
            "",
        ]
        rows = [tuple(name for name, _ in COLUMNS)]
        try:
            rows += [_Entry(self.arguments[0], one).columns() for one in entries if one]
        except (LookupError, ValueError) as error:
            raise self.error(str(error)) from error
        for row in rows:
            for k, cell in enumerate(row):
                mark = "* -" if k == 0 else "  -"
                pieces = cell.split(" |br| ")
                lines.append(f"   {mark} {pieces[0]}")
                for piece in pieces[1:]:
                    lines += ["", f"       {piece}"]
        source = self.state_machine.get_source_and_line(self.lineno)[0]
        parent = nodes.container()
        self.state.nested_parse(StringList(lines, source=source), self.content_offset, parent)
        return parent.children


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("paper-map", PaperMap)
    return {"parallel_read_safe": True}
