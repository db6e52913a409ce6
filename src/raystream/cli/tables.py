"""Tables on stdout: aligned always, bold and wrapped only on a terminal."""

from __future__ import annotations

import io
import shutil
import sys
from collections.abc import Collection, Sequence
from typing import Any

from raystream.cli.console import one_line

#: Width when piped: nothing is wrapped.
PIPED_WIDTH = 10_000


def format_table(
    columns: Sequence[str], rows: Sequence[Sequence[Any]], right: Collection[int] | None = None
) -> str:
    """Format rows as aligned columns.

    Parameters
    ----------
    columns : sequence of str
        Titles; if all are empty, the header line is omitted.
    rows : sequence of sequences
        At least one; integers get commas.
    right : collection of int, optional
        Right-aligned columns. Default: those whose first cell is an integer.

    Returns
    -------
    str
        Lines without trailing spaces.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    if right is None:
        right = [index for index, cell in enumerate(rows[0]) if isinstance(cell, int)]
    table = Table(box=None, pad_edge=False, show_header=any(columns), padding=(0, 2, 0, 0))
    for index, title in enumerate(columns):
        table.add_column(Text(title), justify="right" if index in right else "left")
    for row in rows:
        cells = (f"{cell:,}" if isinstance(cell, int) else str(cell) for cell in row)
        table.add_row(*(Text(_printable(cell)) for cell in cells))
    is_shown = sys.stdout.isatty()
    console = Console(
        file=io.StringIO(),
        force_terminal=is_shown,
        width=shutil.get_terminal_size().columns if is_shown else PIPED_WIDTH,
    )
    with console.capture() as capture:
        console.print(table)
    return "\n".join(line.rstrip() for line in capture.get().splitlines())


def _printable(text: str) -> str:
    """Keep the indent, but nothing that could move the cursor."""
    indent = len(text) - len(text.lstrip(" "))
    return " " * indent + one_line(text)
