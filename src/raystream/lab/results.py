"""Results: what an experiment found, as tables, plots and verdicts, before anyone lays them out."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeVar

from raystream.core.errors import RaystreamError

__all__ = [
    "COMPARED",
    "Cell",
    "Claim",
    "Picture",
    "Plot",
    "Result",
    "Series",
    "Table",
    "Verdict",
    "comparison",
]

Found = TypeVar("Found")

#: A table's cell: text, or a number that whoever lays it out rounds; None where there is none.
Cell = str | int | float | None

#: Columns of a table that compares.
COMPARED = ("quantity", "published", "ours", "ratio", "why they differ")

Verdict = Literal["holds", "holds in part", "does not hold", "not measured"]


@dataclass(frozen=True)
class Table:
    """A table of figures.

    Attributes
    ----------
    name : str
        Short and unique in a report: names its JSON, and its place in the page.
    title : str
    columns : tuple of str
    rows : tuple of tuples of cells
    notes : tuple of str
        What a reader has to know; a sentence each.
    """

    name: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        name: str,
        title: str,
        columns: Sequence[str],
        rows: Iterable[Sequence[Cell]],
        *notes: str,
    ) -> Table:
        """Make a table.

        Raises
        ------
        ValueError
            If a row has not as many cells as there are columns, or two columns have one name.
        """
        if len(set(columns)) != len(columns):
            raise ValueError(f"{name}: columns must differ, got {', '.join(columns)}")
        kept = tuple(tuple(row) for row in rows)
        for row in kept:
            if len(row) != len(columns):
                raise ValueError(f"{name}: {len(columns)} columns, but a row is {row}")
        return cls(name, title, tuple(columns), kept, notes)

    def records(self) -> list[dict[str, Cell]]:
        """Each row as a mapping from its columns."""
        return [dict(zip(self.columns, row, strict=True)) for row in self.rows]


def comparison(
    name: str,
    title: str,
    rows: Iterable[tuple[str, Cell, Cell, str]],
    *notes: str,
) -> Table:
    """Make a table that shows ours beside what was published.

    Parameters
    ----------
    name, title : str
    rows : iterable of tuples
        What it is, the published value, ours, and why they differ; their ratio is added.
    *notes : str

    Returns
    -------
    Table
        With the columns `COMPARED`.
    """
    return Table.of(
        name,
        title,
        COMPARED,
        [(what, theirs, ours, _ratio(ours, theirs), why) for what, theirs, ours, why in rows],
        *notes,
    )


def _ratio(ours: Cell, theirs: Cell) -> float | None:
    if isinstance(ours, str) or isinstance(theirs, str) or not ours or not theirs:
        return None
    return ours / theirs


@dataclass(frozen=True)
class Series:
    """A line, or a colour of bars.

    Attributes
    ----------
    label : str
    x : list
        Numbers, or the names of bars.
    y : list of float
        None where there is no value.
    """

    label: str
    x: list[Any]
    y: list[float | None]


@dataclass(frozen=True)
class Plot:
    """A plot, as figures.

    Attributes
    ----------
    name, title, x_label, y_label : str
    series : list of Series
    kind : {"lines", "bars", "stacked"}
        Bars beside or on top of each other.
    log_x, log_y : bool
    marks : dict of str to float
        Dashed lines across, at a height, with their labels.
    """

    name: str
    title: str
    x_label: str
    y_label: str
    series: list[Series]
    kind: Literal["lines", "bars", "stacked"] = "lines"
    log_x: bool = False
    log_y: bool = False
    marks: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Claim:
    """What a paper says in words, and whether it is so here.

    Attributes
    ----------
    text : str
        The claim, in our words.
    source : str
        Paper and place.
    verdict : Verdict
    evidence : str
        The figures that decide.
    """

    text: str
    source: str
    verdict: Verdict
    evidence: str

    @classmethod
    def judged(cls, text: str, source: str, cases: Mapping[str, bool], evidence: str) -> Claim:
        """Give the verdict over several cases: it holds in all, in some, or in none."""
        verdict: Verdict = "not measured"
        if cases:
            held = sum(cases.values())
            verdict = (
                "holds" if held == len(cases) else "holds in part" if held else "does not hold"
            )
        return cls(text, source, verdict, evidence)


@dataclass(frozen=True)
class Picture:
    """A picture in the report's folder.

    Attributes
    ----------
    title : str
    path : Path
    """

    title: str
    path: Path


@dataclass
class Result:
    """What an experiment found.

    Attributes
    ----------
    tables, plots, claims, pictures : list
    notes : list of str
        Such as why something is missing; a sentence each.
    """

    tables: list[Table] = field(default_factory=list)
    plots: list[Plot] = field(default_factory=list)
    claims: list[Claim] = field(default_factory=list)
    pictures: list[Picture] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def available(
        self, names: Iterable[str], find: Callable[[str], Found]
    ) -> Iterator[tuple[str, Found]]:
        """Each name with what is found for it; a note instead where a model is missing.

        Parameters
        ----------
        names : iterable of str
        find : callable
            Called with a name; a RaystreamError of it becomes the note.
        """
        for name in names:
            try:
                found = find(name)
            except RaystreamError as error:
                self.notes.append(f"{name} is left out: {error}")
            else:
                yield name, found

    def as_json(self) -> dict[str, Any]:
        """Everything, for a file; pictures by their names."""
        return {
            "tables": [
                {
                    "name": table.name,
                    "title": table.title,
                    "columns": list(table.columns),
                    "rows": table.records(),
                    "notes": list(table.notes),
                }
                for table in self.tables
            ],
            "plots": [asdict(plot) for plot in self.plots],
            "claims": [asdict(claim) for claim in self.claims],
            "pictures": [{"title": one.title, "file": one.path.name} for one in self.pictures],
            "notes": list(self.notes),
        }
