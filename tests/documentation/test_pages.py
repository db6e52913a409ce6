"""Code in the documentation: all of it is labelled, and runs unless excepted."""

from __future__ import annotations

import gc
import os
import shutil

import pytest

from documentation.blocks import blocks_of
from documentation.commands import REPOSITORY
from documentation.running import reasons, run_page
from raystream.jit.threads import set_thread_count

DOCS = REPOSITORY / "docs"
FILES = sorted(
    page
    for page in DOCS.rglob("*.rst")
    if page.relative_to(DOCS).parts[0] not in {"_build", "extra", "examples"}
)
PAGES = {page: blocks_of(page) for page in (*FILES, REPOSITORY / "README.md")}
LANGUAGES = {"python", "doctest", "console", "text"}
IDS = [page.relative_to(REPOSITORY).as_posix() for page in PAGES]


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_every_block_has_a_label(page):
    for block in PAGES[page]:
        place = f"{page.name}, line {block.line}"
        assert block.not_run != "", f"{place}: 'not run' needs a reason"
        assert block.not_run or block.language in LANGUAGES, (
            f"{place}: a block {block.language or 'of no language'!r}; say code-block:: python, "
            "console or text, or label it 'not run: reason'"
        )


def test_few_blocks_are_not_run(record_property):
    listed = reasons(PAGES)
    print("\n".join(listed))  # noqa: T201 - to be seen with -s, or where this fails
    record_property("not run", listed)
    shown = sum(block.is_shown for blocks in PAGES.values() for block in blocks)
    assert len(listed) * 10 < shown


@pytest.mark.documentation
@pytest.mark.parametrize(
    "page",
    [page for page, found in PAGES.items() if found],
    ids=[one for one, found in zip(IDS, PAGES.values(), strict=True) if found],
)
def test_page_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    for name in ("RAYSTREAM_DEBUG", "RAYSTREAM_THREADS"):
        monkeypatch.delenv(name, raising=False)
    try:
        run_page(page.relative_to(REPOSITORY).as_posix(), PAGES[page])
        _check_pictures(page, tmp_path)
    finally:
        set_thread_count(None)
        _close_figures()
        gc.collect()
        os.chdir(tmp_path)


def _check_pictures(page, folder):
    """Check that the images that a page shows are written by its code; update them on request."""
    images = DOCS / "images"
    for picture in folder.glob("*.png"):
        if f"images/{picture.name}" in page.read_text(encoding="utf-8"):
            assert (images / picture.name).is_file(), f"{page.name} shows {picture.name}"
            if os.environ.get("RAYSTREAM_RENEW_PICTURES"):
                shutil.copy(picture, images / picture.name)


def _close_figures() -> None:
    try:
        from matplotlib import pyplot as plt
    except ModuleNotFoundError:
        return
    plt.close("all")
