"""The papers' experiments, re-run and compared with the published values."""

from raystream.lab.experiments import EXPERIMENTS, PAPERS, Experiment, Outcome, choose, run_all
from raystream.lab.published import Published, published
from raystream.lab.report import About, write_report
from raystream.lab.results import Claim, Plot, ReportImage, Result, Series, Table, comparison
from raystream.lab.runner import Runner
from raystream.lab.store import Store

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
