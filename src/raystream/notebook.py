"""HTML tables that notebooks show for an object."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

#: Inherits the notebook's colours: readable on light and on dark pages.
_CELL = "text-align:left;padding:0.1em 1em 0.1em 0;vertical-align:top"

_NAME = f"{_CELL};font-weight:normal;opacity:0.75;white-space:pre"

_UNITS = ("bytes", "kB", "MB", "GB", "TB")


def html_table(title: str, rows: Iterable[tuple[str, str]]) -> str:
    """Format names and values as an HTML table.

    Parameters
    ----------
    title : str
    rows : iterable of (str, str)
        Text, which is escaped.

    Returns
    -------
    str
    """
    cells = "".join(
        f'<tr><th scope="row" style="{_NAME}">{escape(name)}</th>'
        f'<td style="{_CELL}">{escape(value)}</td></tr>'
        for name, value in rows
    )
    caption = f'<caption style="text-align:left;font-weight:bold">{escape(title)}</caption>'
    return f'<table style="color:inherit">{caption}<tbody>{cells}</tbody></table>'


def in_bytes(count: float) -> str:
    """A number of bytes in readable form, such as ``1.5 MB``."""
    for unit in _UNITS[:-1]:
        if count < 999.5:
            return f"{count:.3g} {unit}"
        count /= 1000
    return f"{count:,.0f} {_UNITS[-1]}"
