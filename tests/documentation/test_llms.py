"""``llms.txt`` lists existing pages, all of the main ones."""

from __future__ import annotations

import re
from pathlib import Path

from documentation.commands import REPOSITORY

DOCS = REPOSITORY / "docs"

#: Groups of the navigation whose pages are all listed.
LISTED = ("How to", "Explanation", "Reference")

#: Pages of these groups that need no entry of their own.
UNLISTED = {"live", "shader_kernels", "lab"}


def listed_pages() -> list[str]:
    text = (DOCS / "extra" / "llms.txt").read_text(encoding="utf-8")
    links = re.findall(r"(?m)^- \[[^]]+\]\(([^)]+)\): \S", text)
    assert len(links) == text.count("](")
    return [link.removesuffix(".html") for link in links]


def navigation() -> dict[str, list[str]]:
    """The pages of the navigation by group."""
    text = (DOCS / "index.rst").read_text(encoding="utf-8")
    parts = re.findall(r":caption: (.+)\n\n((?:   \S+\n)+)", text)
    return {caption: pages.split() for caption, pages in parts}


def source_of(page: str) -> Path:
    """The file of a page; that of the examples is made from theirs."""
    made_from = {"examples/index": REPOSITORY / "examples" / "README.rst"}
    return made_from.get(page, DOCS / f"{page}.rst")


def test_links_lead_to_pages():
    pages = listed_pages()
    assert len(set(pages)) == len(pages)
    assert not [page for page in pages if not source_of(page).is_file()]


def test_main_pages_are_listed():
    pages = navigation()
    assert len(pages) == 5
    expected = {page for group in LISTED for page in pages[group]} - UNLISTED
    assert not expected - set(listed_pages())
