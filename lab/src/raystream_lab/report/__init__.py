"""Reports of results as Markdown, HTML and JSON."""

from raystream_lab.report.about import About
from raystream_lab.report.markdown import Page, as_pages
from raystream_lab.report.write import build_html, write_report

__all__ = ["About", "Page", "as_pages", "build_html", "write_report"]
