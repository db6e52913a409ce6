"""``raystream view``: a scene in the browser, live."""

from __future__ import annotations

import dataclasses
import os
import signal
import sys
import threading
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any

import typer

from raystream.cli import options
from raystream.cli.bars import Bars
from raystream.cli.keywords import tracer_options
from raystream.cli.messages import one_line, refuse, write_line, write_note
from raystream.cli.opening import Source, Stopwatch, choose_threads, open_tracer
from raystream.cli.render import DEFAULT_SCENE

if TYPE_CHECKING:
    from raystream.tracer import Tracer
    from raystream.viewer.serve import ViewServer

__all__ = ["view"]

MEBIBYTE = 1 << 20


def view(
    scene: options.SceneName = DEFAULT_SCENE,
    host: Annotated[
        str,
        typer.Option(
            metavar="ADDRESS",
            help="Where to be found: by this machine only, or with one of its addresses, or "
            "0.0.0.0, by others too, who then need the token.",
        ),
    ] = "127.0.0.1",
    port: Annotated[
        int | None,
        typer.Option(
            min=0,
            max=65535,
            metavar="N",
            show_default=False,
            help="Without it, 8008 or any that is free.",
        ),
    ] = None,
    token: Annotated[
        str | None,
        typer.Option(
            metavar="TEXT",
            show_default=False,
            help="What a browser must show first: 16 or more letters and digits. Without it one "
            "is made wherever others can reach the viewer.",
        ),
    ] = None,
    browser: Annotated[
        bool | None,
        typer.Option(
            "--open/--no-open",
            show_default=False,
            help="Open the page in a browser; without it, if there is a screen.",
        ),
    ] = None,
    upload_limit: Annotated[
        int,
        typer.Option(
            min=1,
            max=1 << 20,
            metavar="MIB",
            help="Size of a model that is dropped on the page, with all its files, in MiB.",
        ),
    ] = 256,
    mode: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help=f"Renderer at first: {' or '.join(options.MODES)}; {options.MODES[0]} without it.",
            show_default=False,
            callback=options.one_of(options.MODES),
            autocompletion=options.complete(options.MODES),
        ),
    ] = None,
    camera: Annotated[
        str | None,
        typer.Option(metavar="PARTS", help="The view at first, as for render.", show_default=False),
    ] = None,
    structure: options.Structure = None,
    traversal: options.Traversal = None,
    machine: options.Machine = None,
    scheduler: options.Scheduler = None,
    option: options.TracerOption = None,
    device: options.Device = "cpu",
    adapter: options.Adapter = None,
    gpu: options.Gpu = None,
    threads: options.Threads = None,
    time: options.Time = 0.0,
    triangles: options.Triangles = None,
) -> None:
    """Look around in a scene, in the browser. Without SCENE, robots in a city."""
    parts = {} if camera is None else options.parse_camera(camera)
    chosen = tracer_options(
        option or [],
        device,
        adapter=adapter,
        gpu=gpu,
        traversal=traversal,
        machine=machine,
        scheduler=scheduler,
    )
    choose_threads(threads)
    from raystream.viewer.serve import ViewServer, bind, require_packages

    require_packages()
    with ending_cleanly(), bind(host, port) as listener:
        with Bars() as bars:
            source = Source(scene, structure, device, time, triangles, chosen)
            tracer = open_tracer(source, bars, Stopwatch())
        _set_camera(tracer, parts)
        from raystream.viewer.render_service import RenderService

        settings: dict[str, Any] = {} if mode is None else {"mode": mode}
        with ViewServer(
            RenderService(tracer, one_line(scene), settings=settings),
            listener,
            host=host,
            token=token,
            upload_limit=upload_limit * MEBIBYTE,
        ) as server:
            _announce(server, browser)
            server.wait()


def _set_camera(tracer: Tracer, parts: dict[str, Any]) -> None:
    """Begin with the view that was asked for."""
    scene, which = tracer.scene, parts.pop("which", None)
    with refuse(ValueError, where="--camera"):
        if which is not None:
            scene = scene.replace(camera=which)
        if parts:
            scene = scene.replace(camera=dataclasses.replace(scene.camera, **parts))
    tracer.update(scene)


def _announce(server: ViewServer, browser: bool | None) -> None:
    """Say where the viewer is, and show it."""
    write_line(server.url)
    if not server.is_loopback:
        write_note(
            "warning: what goes over the network is not encrypted, the token included; ssh -L is "
            "the way to this viewer over a network that is not yours"
        )
    if browser is None:
        browser = server.is_loopback and _has_screen()
    if browser:
        # Some browsers do not return before they are closed.
        threading.Thread(target=webbrowser.open, args=(server.local_url,), daemon=True).start()
    write_note("Ctrl-C ends the viewer")


def _has_screen() -> bool:
    """Whether somebody would see a browser; without a screen, one would open in the terminal."""
    if not sys.stdout.isatty():
        return False
    if sys.platform in ("win32", "darwin"):
        return "SSH_CONNECTION" not in os.environ
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


@contextmanager
def ending_cleanly() -> Iterator[None]:
    """Let SIGTERM, and a terminal that goes away, end the block as Ctrl-C does.

    Otherwise uploaded files would stay.
    """

    def end(number: int, _: FrameType | None) -> None:
        raise SystemExit(128 + number)

    names = ("SIGTERM", "SIGHUP")
    numbers = [getattr(signal, name) for name in names if hasattr(signal, name)]
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, end) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
