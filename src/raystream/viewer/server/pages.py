"""Pages: the viewer's own files, a list that is fixed when the server starts."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from typing import NamedTuple

__all__ = ["INDEX", "PageFile", "read_page_files"]

#: The page itself; the others are what it asks for.
INDEX = "index.html"

#: Files with other suffixes are not part of the page.
MEDIA_TYPES = {
    ".css": "text/css; charset=utf-8",
    ".html": "text/html; charset=utf-8",
    ".ico": "image/x-icon",
    ".js": "text/javascript; charset=utf-8",
    ".png": "image/png",
    ".svg": "image/svg+xml",
    ".webmanifest": "application/manifest+json",
    ".woff2": "font/woff2",
}


class PageFile(NamedTuple):
    """A file of the page, as it is served."""

    content: bytes
    media_type: str


def read_page_files() -> Mapping[str, PageFile]:
    """Read the page's files, by name: all that the server will ever serve of the disk."""
    folder = files("raystream.viewer").joinpath("page")
    found = {}
    for file in sorted(folder.iterdir(), key=lambda one: one.name):
        media_type = MEDIA_TYPES.get(file.name[file.name.rfind(".") :])
        if media_type is not None and file.is_file():
            found[file.name] = PageFile(file.read_bytes(), media_type)
    return found
