"""Page files: the viewer's static files, listed once when the server starts."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from typing import NamedTuple

#: The page itself; it references the other files.
INDEX = "index.html"

#: Media types; files with other suffixes are not served.
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


#: Files of exported pages only begin with this.
_EXPORTED = "exported."


class PageFile(NamedTuple):
    """A static file of the page."""

    content: bytes
    media_type: str


def read_page_files() -> Mapping[str, PageFile]:
    """Read the page's files, by name; the server reads nothing else from disk.

    Those that exported pages have, too, are in folders of `raystream.web`.
    """
    found = {}
    folders = (("raystream.web", "page"), ("raystream.web", "shared"), ("raystream.viewer", "page"))
    for room, folder in folders:
        for file in sorted(files(room).joinpath(folder).iterdir(), key=lambda one: one.name):
            media_type = MEDIA_TYPES.get(file.name[file.name.rfind(".") :])
            if file.name.startswith(_EXPORTED):
                continue
            if media_type is not None and file.is_file():
                found[file.name] = PageFile(file.read_bytes(), media_type)
    return found
