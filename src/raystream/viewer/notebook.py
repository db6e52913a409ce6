"""view: the viewer in a notebook."""

from __future__ import annotations

import atexit
from html import escape
from os import PathLike
from typing import TYPE_CHECKING, Any

from raystream.core.options import Options
from raystream.scene.load import load
from raystream.scene.scene import Scene
from raystream.viewer.render_service import RenderService
from raystream.viewer.serve import ViewServer, bind, require_packages

if TYPE_CHECKING:
    from raystream.tracer import Tracer

#: Open views: they stay open when the notebook drops its reference, since a page may still show
#: them, and close with the process.
_OPEN: set[View] = set()

#: Settings that are arguments of `Tracer`.
_OF_TRACER = ("structure", "device", "machine", "traversal", "scheduler")

#: Height limits of a frame in a notebook, in pixels.
MIN_HEIGHT, MAX_HEIGHT = 100, 4000


def view(
    scene: Scene | Tracer | str | PathLike[str], *, height: int = 600, **settings: Any
) -> View:
    """Show a scene interactively in the notebook.

    Starts a server on a free port of the loopback address, in a thread; it stops with the
    process, or with `View.close`. Several views can be open at once.

    Parameters
    ----------
    scene : Scene, Tracer, str or path
        The scene to show; names are loaded by `raystream.load`. Passing a tracer avoids
        rebuilding its structure.
    height : int, optional
        Height of the frame in the notebook, in pixels.
    **settings
        Initial settings: ``mode``, ``structure``, ``traversal``, ``machine``, ``scheduler``,
        ``device``, ``max_bounces``, ``exposure``, ``tone``, ``heatmap``, ``maximum`` or
        ``samples``, as on the page. Structure, device and machine may also be options as
        `Tracer` takes them, such as ``structure=rs.Bvh(quality="fast")``.

    Returns
    -------
    View
        Displayed as the output of a cell; elsewhere, its ``url`` opens in a browser on
        this machine.

    Raises
    ------
    RaystreamError
        If the packages of ``raystream[view]`` are not installed.
    FileFormatError
        If a name is not a scene, or the file cannot be read.
    ValueError
        If a setting is unknown, or conflicts with the others.

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
        service = RenderService(scene, name, settings=settings)
    except BaseException:
        listener.close()
        raise
    return View(ViewServer(service, listener), name, height)


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
    """An open viewer, made by `view`. A context manager that closes it."""

    def __init__(self, server: ViewServer, name: str, height: int) -> None:
        self._server = server
        self._name = name
        self._height = height
        _OPEN.add(self)

    @property
    def url(self) -> str:
        """Address for a browser on this machine."""
        return self._server.url

    def close(self) -> None:
        """Close the viewer, and notify its page. Idempotent."""
        self._server.close()
        _OPEN.discard(self)

    def __enter__(self) -> View:
        return self

    def __exit__(self, *error: object) -> None:
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
            f'<p><a href="{url}" target="_blank" rel="noopener">open in a new window</a></p>'
        )


def _close_all() -> None:
    for shown in list(_OPEN):
        shown.close()


atexit.register(_close_all)
