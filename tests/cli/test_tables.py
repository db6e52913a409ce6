"""Tables on stdout."""

from __future__ import annotations

from raystream.cli.tables import format_table


def test_titles_and_cells_are_no_markup():
    text = "0:100:5 [bold]"
    assert format_table([text, "n"], [[text, 1]]).splitlines() == [
        f"{text}  n",
        f"{text}  1",
    ]
