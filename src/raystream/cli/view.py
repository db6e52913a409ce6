"""``raystream view``: explore a scene live in the browser."""

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

from raystream.cli import options
from raystream.cli.bars import Bars
from raystream.cli.camera_options import CameraOptions
from raystream.cli.console import one_line, write_line, write_note
from raystream.cli.load import Stopwatch, choose_threads, open_tracer
from raystream.cli.option_groups import expand_groups
from raystream.cli.render import DEFAULT_SCENE
from raystream.cli.tracer_options import TracerOptions

if TYPE_CHECKING:
    from raystream.tracer import Tracer
    from raystream.viewer.serve import ViewServer

MEBIBYTE = 1 << 20


@dataclasses.dataclass(frozen=True)
class ServerOptions:
    """Options of the local web server."""

    host: Annotated[
        str,
        options.value(
            "ADDRESS",
            "Address to listen on. The default serves this machine only; one of the machine's "
            "addresses, or 0.0.0.0, also serves others, who then need the token.",
        ),
    ] = "127.0.0.1"
    port: Annotated[
        int | None, options.count("Port [default: 8008, or any free one]", least=0, most=65535)
    ] = None
    token: Annotated[
        str | None,
        options.value(
            "TEXT",
            "Access token: 16 or more letters and digits [default: generated if others can "
            "reach the viewer]",
        ),
    ] = None
    browser: Annotated[
        bool | None,
        options.flag(
            "--open/--no-open", "Open the page in a browser [default: if there is a screen]"
        ),
    ] = None
    upload_limit: Annotated[
        int,
        options.count(
            "Maximum size of a model dropped on the page, with all its files, in MiB.",
            most=1 << 20,
            metavar="MIB",
        ),
    ] = 256


@expand_groups
def view(
    scene: options.SceneName = DEFAULT_SCENE,
    *,
    server: ServerOptions,
    mode: Annotated[
        str | None,
        options.choice(
            options.MODES,
            f"Initial renderer: {' or '.join(options.MODES)} [default: raycast]",
        ),
    ] = None,
    camera: CameraOptions,
    tracing: TracerOptions,
    threads: options.Threads = None,
    loading: options.SceneOptions,
) -> None:
    """Explore a scene in the browser. Without SCENE, shows robots in a city."""
    chosen = tracing.arguments()
    choose_threads(threads)
    from raystream.viewer.serve import ViewServer, bind, require_packages

    require_packages()
    with exiting_on_signals(), bind(server.host, server.port) as listener:
        with Bars() as bars:
            tracer = open_tracer(scene, loading, chosen, bars, Stopwatch())
        _set_camera(tracer, camera)
        from raystream.viewer.render_service import RenderService

        settings: dict[str, Any] = {} if mode is None else {"mode": mode}
        with ViewServer(
            RenderService(tracer, one_line(scene), settings=settings),
            listener,
            host=server.host,
            token=server.token,
            upload_limit=server.upload_limit * MEBIBYTE,
        ) as running:
            _announce(running, server.browser)
            running.wait()


def _set_camera(tracer: Tracer, camera: CameraOptions) -> None:
    """Set the initial camera."""
    scene, view = camera.of(tracer.scene, 4.0 / 3.0)
    tracer.update(scene.replace(camera=view) if camera.changes else scene)


def _announce(server: ViewServer, browser: bool | None) -> None:
    """Print the viewer's address, and open it in a browser."""
    write_line(server.url)
    if not server.is_loopback:
        write_note(
            "warning: network traffic is not encrypted, including the token; on an untrusted "
            "network, reach this viewer through ssh -L"
        )
    if browser is None:
        browser = server.is_loopback and _has_screen()
    if browser:
        # Some browsers block until they are closed.
        threading.Thread(target=webbrowser.open, args=(server.local_url,), daemon=True).start()
    write_note("press Ctrl-C to stop the viewer")


def _has_screen() -> bool:
    """Whether a browser would be visible; without a screen, one would open in the terminal."""
    if not sys.stdout.isatty():
        return False
    if sys.platform in ("win32", "darwin"):
        return "SSH_CONNECTION" not in os.environ
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


@contextmanager
def exiting_on_signals() -> Iterator[None]:
    """Make SIGTERM and a closed terminal end the block as Ctrl-C does.

    Otherwise uploaded files would be left behind.
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
