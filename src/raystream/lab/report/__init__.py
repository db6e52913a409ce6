"""Reports of results as HTML, Markdown and JSON."""

from raystream.lab.report.about import About
from raystream.lab.report.html import as_html
from raystream.lab.report.markdown import as_markdown
from raystream.lab.report.write import write_report

__all__ = ["About", "as_html", "as_markdown", "write_report"]
