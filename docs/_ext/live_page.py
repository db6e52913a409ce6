"""A directive: an image of a scene; a click on it loads a page that traces it in the browser.

.. code-block:: rst

   .. live-page:: cornell
      :structure: grid
      :mode: whitted

      A caption.

The argument is one of `PAGES`; what is first seen may be chosen. Pages are exported when the
documentation is built, once for each state of the sources and models. A model that is not there is
not downloaded: another scene takes its place. With other builders than HTML there is the caption
only.
"""

from __future__ import annotations

import hashlib
import html
import os
import shutil
import warnings
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, NamedTuple
from urllib.parse import urlencode

from docutils import nodes
from docutils.parsers.rst import Directive, directives
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment

import raystream as rs
from raystream.core.errors import RaystreamWarning
from raystream.scene.samples import SAMPLES, SCENES_VARIABLE
from raystream.structures import StructureOptions, options_of
from raystream.web.scene_data import MODES
from raystream.web.structure_names import structure_names

#: Most bytes of a page.
MOST_BYTES = 5_000_000

#: The folder of pages and images in the built documentation.
FOLDER = "live"

#: Of the images.
SIZE, SAMPLE_COUNT = (640, 400), 16


class LivePage(NamedTuple):
    """A page to export.

    Parameters
    ----------
    title : str
    scene : str
        The name of a scene.
    structures : tuple of str or StructureOptions
        The first one is first seen.
    mode : str
        First seen, and of the image.
    triangles : int, optional
        Of scenes that have any number of triangles.
    instead : str, optional
        The page to take where the model is not there.
    """

    title: str
    scene: str
    structures: tuple[str | StructureOptions, ...]
    mode: str
    triangles: int | None = None
    instead: str | None = None

    def names(self) -> list[str]:
        """The names of its structures in the page."""
        return structure_names([options_of(one) for one in self.structures])


#: Ways through a kd-tree, of one page.
TRAVERSALS = (
    "kdtree",
    rs.KdTree(traversal="restart"),
    rs.KdTree(traversal="backtrack"),
)

PAGES = {
    "bunny": LivePage("The Stanford bunny", "bunny", ("bvh", "grid"), "raycast", instead="spheres"),
    "cornell": LivePage(
        "A Cornell box", "cornell", ("bvh", "kdtree", "grid", "graph", "brute"), "path"
    ),
    "robots": LivePage("Robots in a city", "robots", ("bvh", "grid"), "shadow"),
    "robots_by_trees": LivePage(
        "Robots in a small city",
        "robots",
        ("bvh", *TRAVERSALS, "graph"),
        "shadow",
        triangles=12_000,
    ),
    "spheres": LivePage("Glass and mirrors", "spheres", ("bvh", "grid"), "whitted"),
}


class Made(NamedTuple):
    """A page that was exported.

    Attributes
    ----------
    name : str
        The page that was made: another one where the model is not there.
    title : str
    page, image : Path
        Files in the cache.
    """

    name: str
    title: str
    page: Path
    image: Path


def is_there(scene: str) -> bool:
    """Whether a scene is built in, or its model in the folder of models."""
    if scene not in SAMPLES:
        return True
    folder = os.environ.get(SCENES_VARIABLE)
    return bool(folder) and (Path(folder) / SAMPLES[scene].main).is_file()


def make_page(name: str, cache_folder: Path) -> Made:
    """Export a page, unless the folder has it from sources and a model of the same content.

    Raises
    ------
    ValueError
        If it is larger than `MOST_BYTES`.
    """
    wanted = PAGES[name]
    if not is_there(wanted.scene):
        if wanted.instead is None:
            raise ValueError(f"{wanted.scene}: no such model, and nothing instead")
        return make_page(wanted.instead, cache_folder)
    key = _key(wanted)
    page, image = (cache_folder / f"{name}-{key}{suffix}" for suffix in (".html", ".png"))
    if not (page.is_file() and image.is_file()):
        cache_folder.mkdir(parents=True, exist_ok=True)
        for before in cache_folder.glob(f"{name}-*"):
            before.unlink(missing_ok=True)
        _export(wanted, page, image)
    if page.stat().st_size > MOST_BYTES:
        raise ValueError(f"{name}: {page.stat().st_size:,} bytes, more than {MOST_BYTES:,}")
    return Made(name, wanted.title, page, image)


def _export(wanted: LivePage, page: Path, image: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RaystreamWarning)  # textures that pages leave out
        scene = rs.load(wanted.scene, triangles=wanted.triangles)
        rs.export_page(scene, page, structures=wanted.structures, size=SIZE)
        rs.render(scene, wanted.mode, SIZE, samples=SAMPLE_COUNT).save(image)


def _key(wanted: LivePage) -> str:
    parts: list[Any] = [wanted, SIZE, SAMPLE_COUNT, _sources()]
    if wanted.scene in SAMPLES:
        main = Path(os.environ[SCENES_VARIABLE]) / SAMPLES[wanted.scene].main
        parts.append(hashlib.sha256(main.read_bytes()).hexdigest())
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:12]


@cache
def _sources() -> str:
    """A hash of the package."""
    digest = hashlib.sha256()
    folder = Path(rs.__file__).parent
    for file in sorted(folder.rglob("*")):
        if file.suffix in (".css", ".html", ".js", ".json", ".npz", ".py", ".wgsl"):
            digest.update(f"{file.relative_to(folder)}\0".encode() + file.read_bytes())
    return digest.hexdigest()


class LivePageDirective(Directive):
    """See the module."""

    required_arguments: ClassVar[int] = 1
    has_content: ClassVar[bool] = True
    option_spec: ClassVar[dict[str, Any]] = {
        "structure": directives.unchanged_required,
        "mode": directives.unchanged_required,
    }

    def run(self) -> list[nodes.Node]:
        """Export the page, and write what shows it."""
        env: BuildEnvironment = self.state.document.settings.env
        name = self.arguments[0]
        if name not in PAGES:
            raise self.error(f"live-page: expected one of {', '.join(PAGES)}, got {name!r}")
        wanted = PAGES[name]
        structures = wanted.names()
        structure = self.options.get("structure", structures[0])
        if structure not in structures:
            known = ", ".join(structures)
            raise self.error(f"live-page: {name} has no structure {structure!r}, but {known}")
        chosen = self.options.get("mode", wanted.mode)
        if chosen not in MODES:
            known = ", ".join(MODES)
            raise self.error(f"live-page: expected a mode of {known}, got {chosen!r}")
        _pages_of(env).setdefault(env.docname, set()).add(name)
        caption = nodes.container(classes=["live-caption"])
        self.state.nested_parse(self.content, self.content_offset, caption)
        if env.app.builder.format != "html":
            return [caption]
        try:
            made = make_page(name, Path(env.app.doctreedir) / FOLDER)
        except (OSError, ValueError) as error:
            raise self.error(f"live-page: {error}") from error
        target = Path(env.app.outdir) / FOLDER
        target.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(made.page, target / f"{made.name}.html")
        shutil.copyfile(made.image, target / f"{made.name}.png")
        if made.name != name:
            missing = f"{wanted.title} was not there when this documentation was built."
            caption.children[:] = [nodes.paragraph("", missing)]
        mode = self.options.get("mode", PAGES[made.name].mode)
        root = "../" * env.docname.count("/") + FOLDER
        address = f"{root}/{made.name}.html#{urlencode({'structure': structure, 'mode': mode})}"
        label = f"{made.title}: {mode}, {structure}, {made.page.stat().st_size / 1e6:.1f} MB"
        opening = (
            f'<figure class="live-page"><a class="live-open" href="{html.escape(address)}" '
            f'data-title="{html.escape(made.title)}, traced in this browser">'
            f'<img src="{root}/{made.name}.png" alt="{html.escape(made.title)}" '
            f'width="{SIZE[0]}" height="{SIZE[1]}" loading="lazy">'
            f'<span class="live-label">▶ Trace it here <small>{html.escape(label)}</small></span>'
            "</a><figcaption>"
        )
        return [
            nodes.raw("", opening, format="html"),
            caption,
            nodes.raw("", "</figcaption></figure>", format="html"),
        ]


def _pages_of(env: BuildEnvironment) -> dict[str, set[str]]:
    """The names of pages, by document."""
    if not hasattr(env, "live_pages"):
        env.live_pages = {}  # type: ignore[attr-defined]
    found: dict[str, set[str]] = env.live_pages  # type: ignore[attr-defined]
    return found


def _outdated(_app: Sphinx, env: BuildEnvironment, *_: object) -> Sequence[str]:
    """Documents with pages are always read: the sources and the models may have changed."""
    return sorted(name for name in _pages_of(env) if name in env.found_docs)


def _purge(_app: Sphinx, env: BuildEnvironment, name: str) -> None:
    _pages_of(env).pop(name, None)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive, and what loads pages on request."""
    app.add_directive("live-page", LivePageDirective)
    app.connect("env-get-outdated", _outdated)
    app.connect("env-purge-doc", _purge)
    app.add_js_file("live_page.js")
    return {"parallel_read_safe": False, "env_version": 1}
