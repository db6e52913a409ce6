"""The papers' experiments, re-run and compared with the published values."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from raystream_lab.published import Published, published

if TYPE_CHECKING:
    from raystream_lab.experiments import (
        EXPERIMENTS,
        PAPERS,
        Experiment,
        Outcome,
        choose,
        run_all,
    )
    from raystream_lab.report import About, write_report
    from raystream_lab.results import (
        Claim,
        Plot,
        ReportImage,
        Result,
        Series,
        Table,
        comparison,
    )
    from raystream_lab.runner import Runner
    from raystream_lab.store import Store

# The rest is imported when first used: `raystream --help` loads the command, and stays quick.
_HOMES = {
    "EXPERIMENTS": "experiments",
    "PAPERS": "experiments",
    "About": "report",
    "Claim": "results",
    "Experiment": "experiments",
    "Outcome": "experiments",
    "Plot": "results",
    "ReportImage": "results",
    "Result": "results",
    "Runner": "runner",
    "Series": "results",
    "Store": "store",
    "Table": "results",
    "choose": "experiments",
    "comparison": "results",
    "run_all": "experiments",
    "write_report": "report",
}

__all__ = [
    "EXPERIMENTS",
    "PAPERS",
    "About",
    "Claim",
    "Experiment",
    "Outcome",
    "Plot",
    "Published",
    "ReportImage",
    "Result",
    "Runner",
    "Series",
    "Store",
    "Table",
    "choose",
    "comparison",
    "published",
    "run_all",
    "write_report",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'raystream_lab' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"raystream_lab.{_HOMES[name]}"), name)
    globals()[name] = value
    return value
