"""The report as Markdown."""

from __future__ import annotations

from collections.abc import Sequence

from raystream_lab.experiments import Outcome
from raystream_lab.report.about import About
from raystream_lab.report.cell_text import are_numbers, cell_text, claims_table
from raystream_lab.results import Plot, Table

__all__ = ["as_markdown"]

#: Beside the report.
_IMAGE_FOLDER = "pictures"


def as_markdown(outcomes: Sequence[Outcome], about: About, plots: Sequence[str] = ()) -> str:
    """Make a Markdown report.

    Parameters
    ----------
    outcomes : sequence of Outcome
    about : About
    plots : sequence of str
        Names of the plots saved as ``plots/NAME.png`` beside the file.
    """
    parts = ["# The papers' experiments, re-run", *about.lines()]
    claims = [claim for one in outcomes for claim in one.result.claims]
    if claims:
        parts += ["## What the papers say", table_text(claims_table(claims))]
    for experiment, result, seconds in outcomes:
        parts.append(f"## {experiment.title}")
        parts += [f"![{one.title}]({_IMAGE_FOLDER}/{one.path.name})" for one in result.images]
        for table in result.tables:
            parts += [f"**{table.title}**", table_text(table), *table.notes]
        parts += [_plot_text(one) for one in result.plots if one.name in plots]
        parts += result.notes
        parts.append(f"`{about.command_for(experiment.name)}` ({seconds:.0f} s)")
    return "\n\n".join(parts) + "\n"


def table_text(table: Table) -> str:
    """A table in Markdown."""
    right = are_numbers(table)
    lines = [
        _line(table.columns),
        "| " + " | ".join("---:" if one else "---" for one in right) + " |",
        *(_line([cell_text(cell) for cell in row]) for row in table.rows),
    ]
    return "\n".join(lines)


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _plot_text(plot: Plot) -> str:
    return f"![{plot.title}](plots/{plot.name}.png)"
