"""A directive: a part of a stored result of ``raystream bench``.

.. code-block:: rst

   .. bench:: performance/result.json chart

The arguments are a file, relative to ``docs``, and one of `PARTS`. It is made of the file
when the pages are built.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from sphinx import addnodes
from sphinx.application import Sphinx

from raystream.bench.chart import chart_text, draw_chart
from raystream.bench.report import (
    Table,
    build_table,
    goal_table,
    machine_line,
    roofline_table,
    speed_tables,
)
from raystream.bench.results import BenchResult, read_result

DOCS = Path(__file__).resolve().parents[1]

#: The tables by the name of their part.
TABLES: dict[str, Callable[[BenchResult], list[Table]]] = {
    "goals": lambda result: [goal_table(result)],
    "roofline": lambda result: [roofline_table(result)],
    "builds": lambda result: [build_table(result)],
    "speeds": speed_tables,
}

#: Parts, folded away until a reader asks for them.
FOLDED = {"speeds": "All speeds, in millions of rays per second", "builds": "Builds and memory"}

PARTS = ("machine", "chart", *TABLES)


class Bench(Directive):
    """See the module."""

    required_arguments: ClassVar[int] = 2

    def run(self) -> list[nodes.Node]:
        """Read the result and make the part."""
        name, part = self.arguments
        path = DOCS / name
        self.state.document.settings.env.note_dependency(str(path))
        if part not in PARTS:
            raise self.error(f"bench: expected one of {', '.join(PARTS)}, got {part!r}")
        try:
            result = read_result(path)
        except (OSError, ValueError) as error:
            raise self.error(f"{name}: {error}") from error
        if part == "machine":
            return self._parsed([_plain(machine_line(result))])
        if part == "chart":
            image = f'<div style="overflow-x: auto">{draw_chart(result)}</div>'
            words = addnodes.only("", nodes.paragraph("", chart_text(result)), expr="not html")
            return [nodes.raw("", image, format="html"), words]
        shown = [node for table in TABLES[part](result) for node in self._table(table)]
        if part not in FOLDED:
            return shown
        opening = f"<details><summary>{FOLDED[part]}</summary>"
        return [
            nodes.raw("", opening, format="html"),
            *shown,
            nodes.raw("", "</details>", format="html"),
        ]

    def _table(self, table: Table) -> list[nodes.Node]:
        lines = [f".. list-table:: {_plain(table.title)}", "   :header-rows: 1", ""]
        for row in (table.columns, *table.rows):
            for k, cell in enumerate(row):
                lines.append(f"   {'* -' if k == 0 else '  -'} {_plain(cell)}")
        return self._parsed(lines)

    def _parsed(self, lines: list[str]) -> list[nodes.Node]:
        source = self.state_machine.get_source_and_line(self.lineno)[0]
        parent = nodes.container()
        self.state.nested_parse(StringList(lines, source=source), self.content_offset, parent)
        return parent.children


def _plain(text: str) -> str:
    """Text without a meaning in reStructuredText."""
    return "".join(f"\\{letter}" if letter in "\\*`|_" else letter for letter in text)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("bench", Bench)
    return {"parallel_read_safe": True}
