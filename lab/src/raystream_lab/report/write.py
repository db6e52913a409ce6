"""Write a report to a folder: Markdown pages, JSON, plots and images; and the pages as HTML."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from raystream.core.atomic_write import atomic_write
from raystream.core.errors import RaystreamError
from raystream_lab.experiments import Outcome
from raystream_lab.report.about import About
from raystream_lab.report.markdown import as_pages
from raystream_lab.report.plots import draw

#: Sphinx's options; its other ones as they are.
_SPHINX = {
    "extensions": "myst_parser",
    "project": "raystream lab",
    "html_theme": "furo",
    "html_title": "raystream lab",
    "html_copy_source": "0",
    "exclude_patterns": "html",
}


def as_json(outcomes: Sequence[Outcome], about: About) -> dict[str, Any]:
    """All results as a JSON value."""
    return {
        "about": about._asdict(),
        "experiments": {one.experiment.name: one.result.as_json() for one in outcomes},
    }


def write_report(folder: Path, outcomes: Sequence[Outcome], about: About) -> list[Path]:
    """Write a report.

    Parameters
    ----------
    folder : Path
        An existing folder.
    outcomes : sequence of Outcome
    about : About

    Returns
    -------
    list of Path
        ``index.md`` and a page for each paper, beside their ``plots`` and ``pictures``;
        ``report.json`` with all figures, and ``about.json`` with the provenance alone.

    Raises
    ------
    OSError
        If a file cannot be written.
    """
    (folder / "plots").mkdir(exist_ok=True)
    plots = [plot for one in outcomes for plot in one.result.plots]
    for plot in plots:
        draw(plot, folder / "plots" / f"{plot.name}.png")
    names = {plot.name for plot in plots}
    pages = as_pages(outcomes, about, names)
    texts = {f"{page.name}.md": page.text for page in pages}
    texts["report.json"] = _as_text(as_json(outcomes, about))
    texts["about.json"] = _as_text(about._asdict())
    for name, text in texts.items():
        with atomic_write(folder / name) as part:
            part.write_text(text, encoding="utf-8")
    return [folder / name for name in texts]


def _as_text(value: Mapping[str, Any]) -> str:
    return json.dumps(value, indent=1, allow_nan=False) + "\n"


def build_html(folder: Path) -> Path:
    """Build the pages of a report as HTML, with Sphinx.

    Parameters
    ----------
    folder : Path
        Of a report.

    Returns
    -------
    Path
        ``html/index.html`` in the folder. The pages load nothing from other hosts.

    Raises
    ------
    RaystreamError
        If Sphinx fails.
    """
    to = folder / "html"
    shutil.rmtree(to, ignore_errors=True)
    command = [sys.executable, "-m", "sphinx", "--builder", "html", "--isolated", "--quiet"]
    for name, value in _SPHINX.items():
        command += ["--define", f"{name}={value}"]
    result = subprocess.run(
        [*command, str(folder), str(to)], capture_output=True, text=True, encoding="utf-8"
    )
    if result.returncode:
        raise RaystreamError(f"{folder}: sphinx failed: {result.stderr.strip()[-500:]}")
    shutil.rmtree(to / ".doctrees", ignore_errors=True)
    return to / "index.html"
