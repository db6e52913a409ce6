"""Sphinx configuration; build with ``python -m sphinx --fail-on-warning docs docs/_build``."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import ClassVar

from docutils import nodes
from docutils.parsers.rst import Directive
from sphinx.application import Sphinx

from raystream import __version__

sys.path.insert(0, str(Path(__file__).with_name("_ext")))
from example_gallery import settings as gallery_settings

project = "raystream"
copyright = "the raystream authors"
release = __version__
version = __version__.rpartition(".")[0]

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.viewcode",
    "myst_nb",
    "numpydoc",
    "bench_result",
    "live_page",
    "paper_map",
    "sphinx_gallery.gen_gallery",
]
sphinx_gallery_conf = gallery_settings(Path(__file__).parent)
exclude_patterns = ["_build", "extra", "examples/**.ipynb"]  # to download

# Notebooks are shown as they were stored, and load nothing from other hosts.
nb_execution_mode = "off"
nb_ipywidgets_js: dict[str, dict[str, str]] = {}
# `Tracer` on any page is a link to raystream.Tracer, and what has no entry is shown as code.
default_role = "py:obj"
rst_prolog = ".. py:currentmodule:: raystream\n"

html_theme = "furo"
html_title = "raystream"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_extra_path = ["extra"]  # llms.txt

# Classes for them are described where they are missing, too: PyTorch is not in [dev].
autodoc_mock_imports = [name for name in ("jax", "torch") if not find_spec(name)]

autodoc_preserve_defaults = True  # defaults as in the source
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings state shape, dtype and unit
numpydoc_show_class_members = False  # api.rst lists them


class CommandHelp(Directive):
    """``.. command-help:: render`` shows what ``raystream render --help`` prints."""

    optional_arguments: ClassVar[int] = 1
    final_argument_whitespace: ClassVar[bool] = True

    def run(self) -> list[nodes.Node]:
        """Run the command line and keep its text."""
        arguments = [*shlex.split(self.arguments[0] if self.arguments else ""), "--help"]
        code = f"import sys; from raystream.cli import main; sys.argv = {['raystream', *arguments]}"
        result = subprocess.run(
            [sys.executable, "-c", f"{code}; main()"],
            env={**os.environ, "COLUMNS": "88", "NO_COLOR": "1", "TERM": "dumb"},
            capture_output=True,
            text=True,
            encoding="utf-8",
        )
        if result.returncode:
            raise self.error(f"raystream {shlex.join(arguments)}: {result.stderr}")
        text = "\n".join(line.rstrip() for line in result.stdout.strip("\n").splitlines())
        return [nodes.literal_block(text, text, language="text")]


def setup(app: Sphinx) -> None:
    """Register the directive."""
    app.add_directive("command-help", CommandHelp)
