"""Reports of results as HTML, Markdown and JSON."""

from raystream_lab.report.about import About
from raystream_lab.report.html import as_html
from raystream_lab.report.markdown import as_markdown
from raystream_lab.report.write import write_report

__all__ = ["About", "as_html", "as_markdown", "write_report"]
