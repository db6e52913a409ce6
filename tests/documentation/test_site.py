"""The built site needs no other host, and its images have alternative texts."""

from __future__ import annotations

import os
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

#: Attributes by which a page loads something, and does not only lead there.
LOADING = {
    "audio": ("src",),
    "embed": ("src",),
    "iframe": ("src",),
    "img": ("src", "srcset"),
    "link": ("href",),
    "object": ("data",),
    "script": ("src",),
    "source": ("src", "srcset"),
    "video": ("src", "poster"),
}


class Reader(HTMLParser):
    """Collects the resources that a page loads, and its images."""

    def __init__(self) -> None:
        super().__init__()
        self.loaded: list[str] = []
        self.without_alt: list[str] = []

    def handle_starttag(self, tag, attrs):
        known = dict(attrs)
        self.loaded += [known[name] for name in LOADING.get(tag, ()) if known.get(name)]
        source = known.get("src") or ""
        # Thumbnails of examples have an empty one, since their titles follow.
        is_thumbnail = known.get("alt") == "" and source.endswith("_thumb.png")
        if tag == "img" and not known.get("alt") and not is_thumbnail:
            self.without_alt.append(source)


def is_remote(address: str) -> bool:
    """Whether an address is on another host."""
    return address.startswith(("http:", "https:", "//"))


def test_what_a_page_loads_is_seen():
    reader = Reader()
    reader.feed(
        '<link href="https://a/b.css"><a href="https://c"><img src="d.png"><img src=e alt=f>'
    )
    assert [one for one in reader.loaded if is_remote(one)] == ["https://a/b.css"]
    assert reader.without_alt == ["d.png"]


@pytest.fixture(scope="module")
def site():
    """Give the folder that .ci/run built."""
    folder = os.environ.get("RAYSTREAM_SITE")
    if not folder:
        pytest.skip("RAYSTREAM_SITE names no built site")
    return Path(folder)


@pytest.mark.documentation
def test_pages_load_nothing_from_other_hosts(site):
    pages = [page for page in site.rglob("*.html") if "_modules" not in page.parts]
    assert len(pages) > 50
    for page in pages:
        reader = Reader()
        reader.feed(page.read_text(encoding="utf-8"))
        remote = [one for one in reader.loaded if is_remote(one)]
        assert not remote, f"{page.relative_to(site)} loads {remote}"


@pytest.mark.documentation
def test_links_of_llms_txt_lead_to_pages(site):
    links = re.findall(r"\]\(([^)]+)\)", (site / "llms.txt").read_text(encoding="utf-8"))
    missing = [link for link in links if not (site / link).is_file()]
    assert links
    assert not missing


@pytest.mark.documentation
def test_styles_load_nothing_from_other_hosts(site):
    for sheet in site.rglob("*.css"):
        text = sheet.read_text(encoding="utf-8").replace('"', "").replace("'", "")
        for form in ("url(http", "url(//", "@import http", "@import //", "@import url(http"):
            assert form not in text, f"{sheet.relative_to(site)}: {form}"


@pytest.mark.documentation
def test_pictures_have_an_alternative_text(site):
    for page in site.rglob("*.html"):
        reader = Reader()
        reader.feed(page.read_text(encoding="utf-8"))
        assert not reader.without_alt, f"{page.relative_to(site)}: {reader.without_alt[:3]}"
