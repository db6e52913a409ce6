"""The report as Markdown pages: an index, and a page for each paper."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from typing import NamedTuple

from raystream_lab.experiments import PAPERS, Outcome
from raystream_lab.published import paper_name, paper_reference, paper_title
from raystream_lab.report.about import About
from raystream_lab.report.cell_text import are_numbers, cell_text, claims_table
from raystream_lab.results import Cell, Claim, Table

#: Beside the pages.
_IMAGES, _PLOTS = "pictures", "plots"

#: Groups of verdicts, see `Claim.judged`.
_VERDICTS = ("holds", "holds in some cases", "does not hold", "not measured")


class Page(NamedTuple):
    """A page of the report.

    Attributes
    ----------
    name : str
        Its file's, without ``.md``.
    text : str
        CommonMark, with tables as on GitHub.
    """

    name: str
    text: str


def as_pages(outcomes: Sequence[Outcome], about: About, plots: Collection[str] = ()) -> list[Page]:
    """Make the pages.

    Parameters
    ----------
    outcomes : sequence of Outcome
    about : About
    plots : collection of str
        Names of the plots saved as ``plots/NAME.png`` beside the pages.

    Returns
    -------
    list of Page
        The index first; then the papers that have outcomes.
    """
    papers = [
        (paper, mine)
        for paper in PAPERS
        if (mine := [one for one in outcomes if one.experiment.paper == paper])
    ]
    pages = [_paper_page(paper, mine, about, plots) for paper, mine in papers]
    claims = {
        paper: [claim for one in mine for claim in one.result.claims] for paper, mine in papers
    }
    parts = [f"# The papers' experiments on the {about.device_name}"]
    parts += [_text(line) for line in about.lines()]
    parts += [
        f"- [{paper_name(paper)}]({paper}.md): {_text(paper_title(paper))}; {len(mine)} experiments"
        for paper, mine in papers
    ]
    parts[-len(papers) :] = ["\n".join(parts[-len(papers) :])] if papers else []
    if any(claims.values()):
        parts += ["## The papers' claims and our verdicts", table_text(_summary(claims))]
    parts.append("\n".join(["```{toctree}", ":hidden:", "", *(p for p, _ in papers), "```"]))
    return [Page("index", _joined(parts)), *pages]


def _paper_page(
    paper: str, outcomes: Sequence[Outcome], about: About, plots: Collection[str]
) -> Page:
    parts = [f"# {paper_name(paper)} on the {about.device_name}", paper_reference(paper)]
    claims = [claim for one in outcomes for claim in one.result.claims]
    if claims:
        parts += ["## The paper's claims and our verdicts", table_text(claims_table(claims))]
    for experiment, result, seconds in outcomes:
        parts.append(f"## {_text(experiment.title)}")
        parts.append(f"`{about.command_for(experiment.name)}` ({seconds:.0f} s)")
        for one in result.images:
            parts += [f"![{_text(one.title)}]({_IMAGES}/{one.path.name})", f"*{_text(one.title)}*"]
        for table in result.tables:
            parts += [f"### {_text(table.title)}", table_text(table), *map(_text, table.notes)]
        parts += [
            f"![{_text(one.title)}]({_PLOTS}/{one.name}.png)"
            for one in result.plots
            if one.name in plots
        ]
        parts += map(_text, result.notes)
    return Page(paper, _joined(parts))


def _summary(claims: dict[str, list[Claim]]) -> Table:
    """How many claims of each paper have which verdict."""
    rows: list[tuple[Cell, ...]] = []
    for paper, mine in claims.items():
        counts = Counter(_verdict_group(one.verdict) for one in mine)
        rows.append((paper_name(paper), len(mine), *(counts[one] for one in _VERDICTS)))
    return Table.of("verdicts", "Verdicts", ("paper", "claims", *_VERDICTS), rows)


def _verdict_group(verdict: str) -> str:
    if verdict.startswith("holds in"):
        return "holds in some cases"
    return next(group for group in _VERDICTS if verdict.startswith(group))


def table_text(table: Table) -> str:
    """A table in Markdown; cells as `cell_text` formats them."""
    right = are_numbers(table)
    lines = [
        _line(table.columns),
        "| " + " | ".join("---:" if one else "---" for one in right) + " |",
        *(_line([cell_text(cell) for cell in row]) for row in table.rows),
    ]
    return "\n".join(lines)


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(_text(cell).replace("|", "\\|") for cell in cells) + " |"


def _text(text: str) -> str:
    """Text with `code` spans: nothing else in it is markup."""
    parts = text.split("`")
    if len(parts) % 2 == 0:  # a single backtick is no code
        parts = [text.replace("`", "'")]
    for k in range(0, len(parts), 2):
        for sign, entity in (("&", "&amp;"), ("<", "&lt;"), ("*", "\\*"), ("[", "\\[")):
            parts[k] = parts[k].replace(sign, entity)
    return "`".join(parts)


def _joined(parts: Sequence[str]) -> str:
    return "\n\n".join(part for part in parts if part) + "\n"
