"""Write a report to a folder: HTML, Markdown, JSON, plots and images."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from raystream.core.atomic_write import atomic_write
from raystream_lab.experiments import Outcome
from raystream_lab.report.about import About
from raystream_lab.report.html import as_html
from raystream_lab.report.markdown import as_markdown
from raystream_lab.report.plots import can_draw, draw

__all__ = ["as_json", "write_report"]


def as_json(outcomes: Sequence[Outcome], about: About) -> dict[str, Any]:
    """All results as a JSON value."""
    return {
        "about": about._asdict(),
        "experiments": {one.experiment.name: one.result.as_json() for one in outcomes},
    }


def write_report(
    folder: Path, outcomes: Sequence[Outcome], about: About, walk: Path | None = None
) -> list[Path]:
    """Write a report.

    Parameters
    ----------
    folder : Path
        An existing folder.
    outcomes : sequence of Outcome
    about : About
    walk : Path, optional
        A page in the folder that shows a ray's walk.

    Returns
    -------
    list of Path
        ``report.html``, self-contained; ``report.md``, beside its ``plots`` and
        ``images``; ``report.json``.

    Raises
    ------
    OSError
        If a file cannot be written.
    """
    drawn: dict[str, Path] = {}
    if can_draw():
        (folder / "plots").mkdir(exist_ok=True)
        for one in outcomes:
            for plot in one.result.plots:
                drawn[plot.name] = folder / "plots" / f"{plot.name}.png"
                draw(plot, drawn[plot.name])
    texts = {
        "report.html": as_html(outcomes, about, drawn, walk.name if walk else None),
        "report.md": as_markdown(outcomes, about, list(drawn)),
        "report.json": json.dumps(as_json(outcomes, about), indent=1, allow_nan=False) + "\n",
    }
    for name, text in texts.items():
        with atomic_write(folder / name) as part:
            part.write_text(text, encoding="utf-8")
    return [folder / name for name in texts]
