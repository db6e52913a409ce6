"""``llms.txt`` lists existing pages, all of the main ones."""

from __future__ import annotations

import re

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


def test_links_lead_to_pages():
    pages = listed_pages()
    assert len(set(pages)) == len(pages)
    missing = [page for page in pages if not (DOCS / f"{page}.rst").is_file()]
    assert not missing


def test_main_pages_are_listed():
    pages = navigation()
    assert len(pages) == 5
    expected = {page for group in LISTED for page in pages[group]} - UNLISTED
    assert not expected - set(listed_pages())
