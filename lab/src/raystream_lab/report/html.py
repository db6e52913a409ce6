"""The report as one self-contained HTML file."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

from raystream_lab.experiments import Outcome
from raystream_lab.published import paper_name
from raystream_lab.report.about import About
from raystream_lab.report.cell_text import are_numbers, cell_text, claims_table, is_number
from raystream_lab.results import Cell, Plot, ReportImage, Table

__all__ = ["as_html"]

_STYLE = """
:root { color-scheme: light dark; --line: #d8dce2; --soft: #f4f6f8; --quiet: #5b6470;
  --good: #14743c; --part: #8a5a00; --bad: #b3261e; --text: #16191d; --ground: #fff;
  --link: #0b5cad }
@media (prefers-color-scheme: dark) { :root { --line: #3a4048; --soft: #1f2429; --quiet: #a3acb8;
  --good: #62c88b; --part: #e0b050; --bad: #ff8a80; --text: #e6e9ec; --ground: #14171a;
  --link: #7ab8ff } }
* { box-sizing: border-box }
body { margin: 0 auto; max-width: 76rem; padding: 1.5rem 1rem 4rem; color: var(--text);
  background: var(--ground); font: 16px/1.5 system-ui, sans-serif }
h1 { font-size: 1.8rem; line-height: 1.2 } h2 { margin-top: 3rem; font-size: 1.35rem;
  border-bottom: 1px solid var(--line); padding-bottom: .3rem }
h3 { margin: 2rem 0 .5rem; font-size: 1.05rem }
a { color: var(--link) } nav li { margin: .15rem 0 }
p.note, p.about { color: var(--quiet); font-size: .92rem; margin: .4rem 0; max-width: 62rem }
div.wide { overflow-x: auto }
table { border-collapse: collapse; font-size: .88rem; margin: .4rem 0 }
th, td { padding: .28rem .6rem; border-bottom: 1px solid var(--line); text-align: left;
  vertical-align: top }
th { background: var(--soft); font-weight: 600 }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap }
code { background: var(--soft); padding: .1rem .3rem; border-radius: 3px; font-size: .86rem;
  overflow-wrap: anywhere }
figure { margin: 1rem 0; max-width: 44rem } figure img { max-width: 100%; height: auto;
  border: 1px solid var(--line); border-radius: 4px; background: #fff }
figcaption { color: var(--quiet); font-size: .88rem }
div.pictures { display: flex; flex-wrap: wrap; gap: 1rem } div.pictures figure { width: 15rem }
.holds, .part, .not { font-weight: 600 }
.holds { color: var(--good) } .part { color: var(--part) } .not { color: var(--bad) }
"""

#: Class of a verdict's cell, the name of the group that matches; see `Claim.judged`.
_VERDICT = re.compile(
    r"(?P<holds>holds)|(?P<part>holds in \d+ of \d+)|(?P<not>does not hold \(0 of \d+\))"
)


def as_html(
    outcomes: Sequence[Outcome],
    about: About,
    plots: Mapping[str, Path],
    walk: str | None = None,
) -> str:
    """Make a self-contained HTML page.

    Parameters
    ----------
    outcomes : sequence of Outcome
    about : About
    plots : mapping of str to Path
        Files of the plots, by name.
    walk : str, optional
        Name of a page beside it that shows a ray's walk.

    Returns
    -------
    str
    """
    title = "The papers' experiments, re-run"
    claims = [claim for one in outcomes for claim in one.result.claims]
    body = [f"<h1>{escape(title)}</h1>"]
    body += [f'<p class="about">{_inline(line)}</p>' for line in about.lines()]
    if walk is not None:
        link = f'<a href="{escape(walk)}">One ray, step by step</a>'
        body.append(f"<p>{link}: through a grid, kd-trees and a graph of sectors.</p>")
    body.append(_contents(outcomes, bool(claims)))
    if claims:
        body.append(_table(claims_table(claims), level=2))
    for experiment, result, seconds in outcomes:
        paper = paper_name(experiment.paper)
        body.append(
            f'<h2 id="{escape(experiment.name)}">{escape(paper)}: {escape(experiment.title)}</h2>'
        )
        command = escape(about.command_for(experiment.name))
        body.append(f"<p><code>{command}</code> ({seconds:.0f} s)</p>")
        if result.images:
            body.append(f'<div class="pictures">{"".join(map(_image, result.images))}</div>')
        body += map(_table, result.tables)
        body += [_plot(one, plots[one.name]) for one in result.plots if one.name in plots]
        body += [f'<p class="note">{_inline(note)}</p>' for note in result.notes]
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>raystream: {escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
        + "\n".join(body)
        + "\n</body>\n</html>\n"
    )


def _inline(text: str) -> str:
    """Escape text, with `code` spans."""
    parts = escape(text).split("`")
    return "".join(
        f"<code>{part}</code>" if number % 2 else part for number, part in enumerate(parts)
    )


def _contents(outcomes: Sequence[Outcome], has_claims: bool) -> str:
    items = ['<li><a href="#claims">What the papers say</a></li>'] if has_claims else []
    items += [
        f'<li><a href="#{escape(one.name)}">{escape(paper_name(one.paper))}: '
        f"{escape(one.title)}</a></li>"
        for one, *_ in outcomes
    ]
    return f'<nav aria-label="Contents"><ul>{"".join(items)}</ul></nav>'


def _table(table: Table, level: int = 3) -> str:
    right = are_numbers(table)
    head = "".join(
        f"<th{' class=number' if one else ''} scope=col>{escape(name)}</th>"
        for one, name in zip(right, table.columns, strict=True)
    )
    rows = "".join(
        "<tr>"
        + "".join(f"<td{_cell_class(cell)}>{_inline(cell_text(cell))}</td>" for cell in row)
        + "</tr>\n"
        for row in table.rows
    )
    notes = "".join(f'<p class="note">{_inline(note)}</p>' for note in table.notes)
    return (
        f'<h{level} id="{escape(table.name)}">{escape(table.title)}</h{level}>\n'
        '<div class="wide"><table>'
        f"<thead><tr>{head}</tr></thead>\n<tbody>{rows}</tbody></table></div>{notes}"
    )


def _cell_class(cell: Cell) -> str:
    if is_number(cell) or cell is None:
        return " class=number"
    verdict = _VERDICT.fullmatch(str(cell))
    return f" class={verdict.lastgroup}" if verdict else ""


def _plot(plot: Plot, path: Path) -> str:
    return (
        f'<figure><img src="{_inside(path)}" alt="{escape(plot.title)}">'
        f"<figcaption>{_inline(plot.title)}</figcaption></figure>"
    )


def _image(image: ReportImage) -> str:
    return (
        f'<figure><img src="{_inside(image.path)}" alt="{escape(image.title)}">'
        f"<figcaption>{_inline(image.title)}</figcaption></figure>"
    )


def _inside(path: Path) -> str:
    """A PNG file as a data URL."""
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode("ascii")
