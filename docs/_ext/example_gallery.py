"""The pages of examples, by sphinx-gallery: each file runs, and its page shows what it wrote."""

from __future__ import annotations

import logging
import shutil
from pathlib import Path
from typing import Any

from sphinx_gallery.scrapers import figure_rst
from sphinx_gallery.sorting import ExplicitOrder

#: Arguments of examples whose images are small without; their docstrings name them, too.
ARGUMENTS = {
    "glass_model.py": ["ring", "480x360", "64"],
    "instances.py": ["480x270", "8"],
    "materials.py": ["640x240", "32"],
    "xray_engine.py": ["640x480", "16"],
}


def saved_images(_block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Move the PNG files that an example wrote to its page; return reStructuredText for them."""
    source = Path(block_vars["src_file"])
    title = source.read_text(encoding="utf-8").split("\n")[1]
    taken = []
    for image in sorted(source.parent.glob("*.png")):
        taken.append(next(block_vars["image_path_iterator"]))
        shutil.move(image, taken[-1])
    return str(figure_rst(taken, gallery_conf["src_dir"], title))


def arguments(_gallery_conf: dict[str, Any], script_vars: dict[str, Any]) -> list[str]:
    """Give an example's command line, after the name of the file."""
    return ARGUMENTS.get(Path(script_vars["src_file"]).name, [])


def settings(docs: Path) -> dict[str, Any]:
    """Copy the examples, where they may leave files, and configure the gallery of them."""
    logging.getLogger("distributed").propagate = False  # Sphinx shows every record
    copies = docs / "_build" / "examples"
    shutil.rmtree(copies, ignore_errors=True)
    skip = shutil.ignore_patterns("__pycache__")
    shutil.copytree(docs.parent / "examples", copies, ignore=skip)
    sections = ("simulation", "queries", "images", "streams")
    return {
        "examples_dirs": "_build/examples",
        "gallery_dirs": "examples",
        "subsection_order": ExplicitOrder([f"_build/examples/{name}" for name in sections]),
        "within_subsection_order": "FileNameSortKey",
        "filename_pattern": r"\.py$",
        "image_scrapers": ("example_gallery.saved_images",),
        "reset_modules": (),
        "reset_argv": "example_gallery.arguments",
        "abort_on_example_error": True,
        "capture_repr": (),
        "download_all_examples": False,
        "reference_url": {"raystream": None},
        "show_signature": False,
        "write_computation_times": False,
        "default_thumb_file": str(docs / "images" / "example.png"),
    }
