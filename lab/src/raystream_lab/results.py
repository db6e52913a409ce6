"""Results of experiments: tables, plots and verdicts, independent of their layout."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeVar

import pandas as pd

from raystream.core.errors import RaystreamError

Found = TypeVar("Found")

#: A table's cell: text, or a number that is rounded on output; None if there is no value.
Cell = str | int | float | None

#: Columns of comparison tables.
COMPARED = ("quantity", "published", "ours", "ratio", "why they differ")

#: Maximum relative deviation of values that are called equal.
TOLERANCE = 0.25

#: The reason of a difference that no experiment explains.
NOT_EXPLAINED = "not explained"


@dataclass(frozen=True)
class Table:
    """A table of figures.

    Attributes
    ----------
    name : str
        Short and unique in a report: names it in JSON and its anchor in the page.
    title : str
    frame : pandas.DataFrame
        Of cells as they are: dtype object.
    notes : tuple of str
        Explanations, a sentence each.

    Notes
    -----
    A row whose ratio to the published value is off by more than `TOLERANCE` has a reason: where
    none is given, "why they differ" becomes `NOT_EXPLAINED`.
    """

    name: str
    title: str
    frame: pd.DataFrame
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
            If a row has the wrong number of cells, or two columns share a name.
        """
        if len(set(columns)) != len(columns):
            raise ValueError(f"{name}: columns must be unique, got {', '.join(columns)}")
        kept = tuple(tuple(row) for row in rows)
        for row in kept:
            if len(row) != len(columns):
                raise ValueError(f"{name}: {len(columns)} columns, but a row is {row}")
        ours = next((one for one in columns if one.startswith("ours")), None)
        if ours and {"published", COMPARED[-1]} <= set(columns):
            kept = tuple(_with_reason(columns, row, ours) for row in kept)
        return cls(name, title, pd.DataFrame(kept, columns=list(columns), dtype=object), notes)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns."""
        return tuple(self.frame.columns)

    @property
    def rows(self) -> tuple[tuple[Cell, ...], ...]:
        """The cells, row by row."""
        return tuple(self.frame.itertuples(index=False, name=None))

    def records(self) -> list[dict[str, Cell]]:
        """Rows as mappings from column names."""
        return [dict(zip(self.columns, row, strict=True)) for row in self.rows]


def comparison(
    name: str,
    title: str,
    rows: Iterable[tuple[str, Cell, Cell, str]],
    *notes: str,
) -> Table:
    """Make a table that compares our values with the published ones.

    Parameters
    ----------
    name, title : str
    rows : iterable of tuples
        Quantity, published value, our value, and why they differ; the ratio is added, and
        `NOT_EXPLAINED` where it is off without a reason, see `Table`.
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


def listed(values: Mapping[str, float], form: str = ".3g") -> str:
    """Named values as text, such as ``"a 1.5, b 2"``."""
    return ", ".join(f"{name} {value:{form}}" for name, value in values.items())


def is_near(ours: float, theirs: float) -> bool:
    """Whether two values agree within `TOLERANCE`."""
    return ours == theirs if not theirs else abs(ours / theirs - 1.0) <= TOLERANCE


def _with_reason(columns: Sequence[str], row: tuple[Cell, ...], ours: str) -> tuple[Cell, ...]:
    """A row of a comparison that says so if a difference is not explained."""
    cells = dict(zip(columns, row, strict=True))
    own, theirs = cells[ours], cells["published"]
    if cells[COMPARED[-1]] or not isinstance(own, int | float):
        return row
    if not isinstance(theirs, int | float) or is_near(own, theirs):
        return row
    return tuple((cells | {COMPARED[-1]: NOT_EXPLAINED}).values())


def _ratio(ours: Cell, theirs: Cell) -> float | None:
    if isinstance(ours, str) or isinstance(theirs, str) or not ours or not theirs:
        return None
    return ours / theirs


@dataclass(frozen=True)
class Series:
    """A line, or a group of bars of one colour.

    Attributes
    ----------
    label : str
    x : list
        Numbers, or names of bars.
    y : list of float
        None for missing values.
    """

    label: str
    x: list[Any]
    y: list[float | None]


@dataclass(frozen=True)
class Plot:
    """The data of a plot.

    Attributes
    ----------
    name, title, x_label, y_label : str
    series : list of Series
    kind : {"lines", "bars", "stacked"}
        Bars side by side or stacked.
    log_x, log_y : bool
    marks : dict of str to float
        Heights of horizontal dashed lines, by label.
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
    """A paper's verbal claim, and whether it holds here.

    Attributes
    ----------
    text : str
        The claim in our words.
    source : str
        Paper and place.
    verdict : str
        See `judged`.
    evidence : str
        The figures that decide it.
    """

    text: str
    source: str
    verdict: str
    evidence: str

    @classmethod
    def judged(cls, text: str, source: str, cases: Mapping[str, bool], evidence: str) -> Claim:
        """Judge a claim by several cases.

        The verdict is ``"holds"`` (in all cases), ``"holds in 2 of 3"``, ``"does not hold (0 of
        3)"``, or ``"not measured"`` without cases.
        """
        held, count = sum(cases.values()), len(cases)
        if not cases:
            verdict = "not measured"
        elif held == count:
            verdict = "holds"
        elif held:
            verdict = f"holds in {held} of {count}"
        else:
            verdict = f"does not hold (0 of {count})"
        return cls(text, source, verdict, evidence)


@dataclass(frozen=True)
class ReportImage:
    """An image in the report's folder.

    Attributes
    ----------
    title : str
    path : Path
    """

    title: str
    path: Path


@dataclass
class Result:
    """The result of an experiment.

    Attributes
    ----------
    tables, plots, claims, images : list
    notes : list of str
        Such as why something is missing, a sentence each.
    """

    tables: list[Table] = field(default_factory=list)
    plots: list[Plot] = field(default_factory=list)
    claims: list[Claim] = field(default_factory=list)
    images: list[ReportImage] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def available(
        self, names: Iterable[str], find: Callable[[str], Found]
    ) -> Iterator[tuple[str, Found]]:
        """Yield each name with its result; if a model is missing, add a note instead.

        Parameters
        ----------
        names : iterable of str
        find : callable
            Called with a name; a RaystreamError becomes the note.
        """
        for name in names:
            try:
                found = find(name)
            except RaystreamError as error:
                self.notes.append(f"{name} is left out: {error}")
            else:
                yield name, found

    def as_json(self) -> dict[str, Any]:
        """The result as a JSON value; images by file name."""
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
            "pictures": [{"title": one.title, "file": one.path.name} for one in self.images],
            "notes": list(self.notes),
        }
