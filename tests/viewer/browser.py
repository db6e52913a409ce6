"""A browser on the viewer's page: headless Chromium, and its actions."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import parse_qs, urlsplit

import pytest

from conftest import child_environment
from extras import need

PROGRAMS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")

#: Seconds that anything may take: kernels may have to be compiled.
PATIENCE = 300.0

#: A phone's screen and touch input.
PHONE = {
    "viewport": {"width": 390, "height": 844},
    "has_touch": True,
    "is_mobile": True,
    "device_scale_factor": 2,
}


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    """A browser; tests that need one skip without it."""
    need("playwright")
    from playwright import sync_api

    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        pytest.skip(f"needs a browser: one of {', '.join(PROGRAMS)}")
    is_root = hasattr(os, "geteuid") and os.geteuid() == 0
    arguments = ["--disable-gpu", *(["--no-sandbox"] if is_root else [])]
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=arguments)
        yield browser
        browser.close()


@contextmanager
def serving(scene: str, *options: str) -> Iterator[str]:
    """The address of a viewer of a scene, in a separate process."""
    need("starlette", "uvicorn", "websockets")
    command = [sys.executable, "-m", "raystream", "view", scene, "--port", "0", "--no-open"]
    process = subprocess.Popen(
        [*command, *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env=child_environment(),
        text=True,
    )
    assert process.stdout is not None
    said = []
    try:
        for line in process.stdout:
            said.append(line)
            if found := re.search(r"http://\S+", line):
                yield found[0]
                return
        pytest.fail(f"the viewer did not start: {''.join(said)}")
    finally:
        process.terminate()
        process.wait(PATIENCE)
        process.stdout.close()


class Viewer:
    """The page, open in a browser.

    Parameters
    ----------
    browser : playwright Browser
    address : str
        Of the server.
    fragment : str
        What the page's address says of the view and the settings.
    **options
        Of the browser's context: viewport, color_scheme and so on; ``before`` is a script to run
        before the page's.
    """

    def __init__(
        self, browser: Any, address: str, fragment: str = "#samples=1", **options: Any
    ) -> None:
        before = options.pop("before", "")
        options.setdefault("viewport", {"width": 840, "height": 420})
        self.address = address
        self.context = browser.new_context(**options)
        self.context.set_default_timeout(1000 * PATIENCE)
        self.page = self.context.new_page()
        self.problems: list[str] = []
        self.messages: list[dict[str, Any]] = []
        self.sent: list[dict[str, Any]] = []
        self._watch()
        if before:
            self.page.add_init_script(before)
        answer = self.page.goto(address + fragment)
        assert answer is not None
        assert answer.ok, f"{answer.status} instead of a page at {address}"
        self.page.locator("#stage[data-frame]").wait_for()

    def _watch(self) -> None:
        host = urlsplit(self.address).netloc

        def on_console(message: Any) -> None:
            if message.type in ("error", "warning"):
                self.problems.append(f"console: {message.text}")

        def on_request(request: Any) -> None:
            parts = urlsplit(request.url)
            if parts.netloc != host and parts.scheme not in ("blob", "data"):
                self.problems.append(f"asks another host: {request.url}")

        def on_response(response: Any) -> None:
            if response.status >= 400 and "/uploads/" not in response.url:
                self.problems.append(f"{response.status}: {response.url}")

        def on_socket(socket: Any) -> None:
            socket.on("framereceived", lambda text: self._keep(text, self.messages))
            socket.on("framesent", lambda text: self._keep(text, self.sent))

        self.page.on("console", on_console)
        self.page.on("pageerror", lambda error: self.problems.append(f"error: {error}"))
        self.page.on("request", on_request)
        self.page.on("response", on_response)
        self.page.on("websocket", on_socket)

    @staticmethod
    def _keep(content: str | bytes, into: list[dict[str, Any]]) -> None:
        if isinstance(content, bytes):
            length = int.from_bytes(content[:4], "little")
            content = content[4 : 4 + length].decode()
        into.append(json.loads(content))

    def close(self) -> None:
        """Close the page, and fail if it reported errors."""
        self.context.close()
        assert not self.problems, "\n".join(self.problems)

    @property
    def said(self) -> dict[str, str]:
        """Parameters in the page's address."""
        fragment = urlsplit(self.page.url).fragment
        return {name: values[0] for name, values in parse_qs(fragment).items()}

    @property
    def camera(self) -> dict[str, Any]:
        """The camera that was sent last."""
        return [one for one in self.sent if one["type"] == "camera"][-1]

    def last(self, kind: str) -> dict[str, Any]:
        """The last message of a kind that the server sent."""
        return [one for one in self.messages if one["type"] == kind][-1]

    def wait(self, condition: Callable[[], Any], what: str) -> Any:
        """Wait until something holds, and return it."""
        end = time.monotonic() + PATIENCE
        while not (found := condition()):
            assert time.monotonic() < end, f"waited in vain for {what}"
            self.page.wait_for_timeout(30)
        return found

    def picture(self) -> str:
        """The current content of the canvas."""
        pixels = self.page.locator("#picture").evaluate("canvas => canvas.toDataURL()")
        return hashlib.sha256(pixels.encode()).hexdigest()

    def wait_for_rest(self) -> str:
        """Wait for a whole image of a camera at rest, and return it."""

        def is_done() -> bool:
            frame = self.last("frame")
            drawn = self.page.locator("#stage").get_attribute("data-frame")
            return frame["done"] and drawn == str(frame["number"]) and not self.camera["moving"]

        self.wait(is_done, "a picture that is done")
        return self.picture()

    @contextmanager
    def changing_picture(self) -> Iterator[None]:
        """A context in which the image must change."""
        before = self.picture()
        yield
        self.wait(lambda: self.picture() != before, "another picture")

    def choose(self, name: str, value: str) -> None:
        """Choose a setting, and wait for an image that shows it."""

        def in_effect(message: dict[str, Any]) -> bool:
            return message["type"] == "settings" and (message[name] or "") == value

        def is_shown() -> bool:
            new = self.messages[start:]
            at = next((i for i, message in enumerate(new) if in_effect(message)), len(new))
            return any(message["type"] == "frame" for message in new[at:])

        if in_effect(self.last("settings")):
            return
        start = len(self.messages)
        self.page.select_option(f"select[name={name}]", value)
        self.wait(is_shown, f"{name} to be {value}")
        assert not self.last("settings").get("refused")

    def place(self, x: float, y: float) -> tuple[float, float]:
        """Page coordinates of a point of the image, given by fractions."""
        box = self.page.locator("#picture").bounding_box()
        return box["x"] + x * box["width"], box["y"] + y * box["height"]

    def drag(self, start: tuple[float, float], end: tuple[float, float], steps: int = 5) -> None:
        """Drag from one place of the image to another."""
        mouse = self.page.mouse
        mouse.move(*self.place(*start))
        mouse.down()
        mouse.move(*self.place(*end), steps=steps)
        mouse.up()

    def toast(self, text: str) -> None:
        """Wait for a message on the page."""
        self.page.locator(".toast", has_text=text).first.wait_for()
