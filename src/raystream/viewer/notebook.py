"""view: the viewer in a notebook."""

from __future__ import annotations

import atexit
from html import escape
from os import PathLike
from types import TracebackType
from typing import TYPE_CHECKING, Any

from raystream.core.options import Options
from raystream.scene.load import load
from raystream.scene.scene import Scene
from raystream.viewer.serve import ViewServer, bind, require_packages
from raystream.viewer.studio import Studio

if TYPE_CHECKING:
    from raystream.tracer import Tracer

__all__ = ["View", "view"]

#: Views that are open: they go on when the notebook forgets them, since a page may still show
#: them, and end with the process.
_OPEN: set[View] = set()

#: Settings that are arguments of `Tracer`.
_OF_TRACER = ("structure", "device", "machine", "traversal", "scheduler")

#: Heights that a frame in a notebook can have, in pixels.
MIN_HEIGHT, MAX_HEIGHT = 100, 4000


def view(
    scene: Scene | Tracer | str | PathLike[str], *, height: int = 600, **settings: Any
) -> View:
    """Show a scene in the notebook, to look around in it.

    Starts a server on a free port of the loopback address, in a thread; it ends with the
    process, or with `View.close`. Several can be open at once.

    Parameters
    ----------
    scene : Scene, Tracer, str or path
        What to show; `raystream.load` loads what is a name. A tracer saves building its
        structure once more.
    height : int, optional
        Of the frame in the notebook, in pixels.
    **settings
        What to begin with: ``mode``, ``structure``, ``traversal``, ``machine``, ``scheduler``,
        ``device``, ``max_bounces``, ``exposure``, ``tone``, ``heatmap``, ``maximum`` or
        ``samples``, as the page has them. Structure, device and machine may also be options as
        `Tracer` takes them, such as ``structure=rs.Bvh(quality="high")``.

    Returns
    -------
    View
        Shows itself at the end of a cell; elsewhere its ``url`` can be opened in a browser on
        this machine.

    Raises
    ------
    RaystreamError
        If the packages of ``raystream[view]`` are not installed.
    FileFormatError
        If a name is none of a scene, or the file cannot be used.
    ValueError
        If a setting is none, or does not go with the others.

    Examples
    --------
    >>> import raystream as rs
    >>> rs.view("cornell", mode="path")  # doctest: +SKIP
    >>> with rs.view(rs.load("bunny.ply")) as shown:  # doctest: +SKIP
    ...     print(shown.url)
    """
    if not MIN_HEIGHT <= height <= MAX_HEIGHT:
        raise ValueError(f"height: expected {MIN_HEIGHT} to {MAX_HEIGHT} pixels, got {height}")
    require_packages()
    if isinstance(scene, str | PathLike):
        scene = load(scene)
    scene = _traced(scene, settings)
    shown = scene if isinstance(scene, Scene) else getattr(scene, "scene", None)
    name = getattr(shown, "name", "") or "scene"
    listener = bind("127.0.0.1", 0)
    try:
        studio = Studio(scene, name, settings=settings)
    except BaseException:
        listener.close()
        raise
    return View(ViewServer(studio, listener), name, height)


def _traced(scene: Scene | Tracer, settings: dict[str, Any]) -> Scene | Tracer:
    """The scene; with a tracer where settings are typed options, which are taken out of them."""
    typed = any(isinstance(settings.get(name), Options) for name in _OF_TRACER)
    if not typed:
        return scene
    if not isinstance(scene, Scene):
        raise ValueError("structure, device, machine: the tracer given has its own")
    from raystream.tracer import Tracer

    given = {name: settings.pop(name) for name in _OF_TRACER if name in settings}
    return Tracer(scene, **given)


class View:
    """A viewer that is open; `view` makes it. A context manager, which closes it."""

    def __init__(self, server: ViewServer, name: str, height: int) -> None:
        self._server = server
        self._name = name
        self._height = height
        _OPEN.add(self)

    @property
    def url(self) -> str:
        """Where a browser on this machine finds it."""
        return self._server.url

    def close(self) -> None:
        """End it; a page that shows it says so. Again has no effect."""
        self._server.close()
        _OPEN.discard(self)

    def __enter__(self) -> View:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        state = f"at {self.url}" if self._server.is_running else "closed"
        return f"<view of {self._name} {state}>"

    def _repr_html_(self) -> str:
        if not self._server.is_running:
            return f"<p>The view of {escape(self._name)} is closed.</p>"
        url, name = escape(self.url), escape(self._name)
        return (
            f'<iframe src="{url}" title="raystream: {name}" width="100%" height="{self._height}" '
            'style="border: 0" allow="fullscreen"></iframe>'
            f'<p><a href="{url}" target="_blank" rel="noopener">open in a window of its own</a></p>'
        )


def _close_all() -> None:
    for shown in list(_OPEN):
        shown.close()


atexit.register(_close_all)
