"""The parts of a page, written as one file or as a folder of files for a server."""

from __future__ import annotations

import base64
import hashlib
import html
import re
from os import PathLike
from pathlib import Path
from typing import NamedTuple

from raystream.core.atomic_write import atomic_write


class PageParts(NamedTuple):
    """What a page is made of.

    Attributes
    ----------
    title : str
    template : str
        HTML with ``{{name}}`` where the other parts go.
    style, script : str
    image : bytes
        A PNG file.
    data : bytes
        What ``page/pack.js`` unpacks.
    """

    title: str
    template: str
    style: str
    script: str
    image: bytes
    data: bytes


def write_file(path: str | PathLike[str], parts: PageParts) -> int:
    """Write a page as one file; returns its bytes.

    Its content security policy allows this script and style only, by their hashes.
    """
    content = _filled(
        parts,
        policy=_policy(
            image="data:", script=f"'{_hash(parts.script)}'", style=f"'{_hash(parts.style)}'"
        ),
        style=f"<style>{parts.style}</style>",
        preview=f"data:image/png;base64,{_base64(parts.image)}",
        data=f'<script type="application/octet-stream" id="data">{_base64(parts.data)}</script>',
        script=f'<script type="module">{parts.script}</script>',
    )
    _write(Path(path), content)
    return len(content)


def write_folder(path: str | PathLike[str], parts: PageParts) -> int:
    """Write a page as files in a folder, which is made if there is none; returns their bytes.

    Its content security policy allows files of the same server only. Addresses have a part of the
    files' hashes: a browser that has kept files of another version does not use them.
    """
    folder = Path(path)
    if folder.exists() and not folder.is_dir():
        raise NotADirectoryError(f"{folder}: is a file, not a folder")
    folder.mkdir(exist_ok=True)
    files = {
        "page.css": parts.style.encode(),
        "page.js": f'"use strict";\n{parts.script}'.encode(),
        "preview.png": parts.image,
        "data.bin": parts.data,
    }
    address = {
        name: f"{name}?{hashlib.sha256(content).hexdigest()[:8]}" for name, content in files.items()
    }
    files["index.html"] = _filled(  # last, so that it never names files that are not there yet
        parts,
        policy=_policy(image="'self' data:", script="'self'", style="'self'")
        + "; connect-src 'self'",
        style=f'<link rel="stylesheet" href="{address["page.css"]}">',
        preview=address["preview.png"],
        data=f'<script type="application/octet-stream" id="data" data-file="{address["data.bin"]}">'
        "</script>",
        script=f'<script defer src="{address["page.js"]}"></script>',
    )
    for name, content in files.items():
        _write(folder / name, content)
    return sum(map(len, files.values()))


def _policy(image: str, script: str, style: str) -> str:
    return (
        f"default-src 'none'; img-src {image}; script-src {script}; style-src {style}; "
        "base-uri 'none'; form-action 'none'"
    )


def _filled(parts: PageParts, **found: str) -> bytes:
    found["title"] = html.escape(parts.title)
    return re.sub(r"\{\{(\w+)\}\}", lambda match: found[match[1]], parts.template).encode()


def _write(path: Path, content: bytes) -> None:
    with atomic_write(path) as file:
        file.write_bytes(content)


def _base64(content: bytes) -> str:
    return base64.b64encode(content).decode("ascii")


def _hash(text: str) -> str:
    return f"sha256-{_base64(hashlib.sha256(text.encode()).digest())}"
