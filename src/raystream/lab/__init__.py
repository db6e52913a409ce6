"""The lab: the papers' experiments, re-run beside what they published."""

from raystream.lab.experiments import EXPERIMENTS, PAPERS, Experiment, Outcome, choose, run_all
from raystream.lab.published import Published, published
from raystream.lab.report import About, write_report
from raystream.lab.results import Claim, Picture, Plot, Result, Series, Table, comparison
from raystream.lab.runner import Runner
from raystream.lab.store import Store

__all__ = [
    "EXPERIMENTS",
    "PAPERS",
    "About",
    "Claim",
    "Experiment",
    "Outcome",
    "Picture",
    "Plot",
    "Published",
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
