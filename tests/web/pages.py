"""Exported pages in headless Chromium, with WebGPU in software."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from extras import need
from viewer.browser import PATIENCE, PROGRAMS

#: Software WebGPU; the last three make it draw to a canvas, too. On busy cores shaders run for
#: longer than Chromium's watchdog allows.
ARGUMENTS = (
    "--disable-gpu-watchdog",
    "--enable-unsafe-webgpu",
    "--use-webgpu-adapter=swiftshader",
    "--use-vulkan=swiftshader",
    "--enable-features=Vulkan",
    "--use-angle=vulkan",
)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A browser with WebGPU; tests skip without one."""
    need("playwright")
    from playwright import sync_api

    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        pytest.skip(f"needs a browser: one of {', '.join(PROGRAMS)}")
    is_root = hasattr(os, "geteuid") and os.geteuid() == 0
    arguments = [*ARGUMENTS, *(["--no-sandbox"] if is_root else [])]
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=arguments)
        yield browser
        browser.close()


class Exported:
    """An exported page, from disk or a server; on leaving it, no problem may have been reported.

    Parameters
    ----------
    browser : playwright Browser
    path : Path or str
        A file, or an address.
    size : (int, int)
    before : str
        A script to run before the page's.
    """

    def __init__(
        self, browser: Any, path: Path | str, size: tuple[int, int] = (96, 72), before: str = ""
    ) -> None:
        self.context = browser.new_context(viewport={"width": size[0], "height": size[1]})
        self.page = self.context.new_page()
        self.problems: list[str] = []
        self.requests: list[str] = []
        self.page.on("pageerror", lambda error: self.problems.append(f"error: {error}"))
        self.page.on(
            "console",
            lambda one: (
                self.problems.append(one.text) if one.type in ("error", "warning") else None
            ),
        )
        self.page.on("request", lambda one: self.requests.append(one.url))
        if before:
            self.page.add_init_script(before)
        self.page.goto(path if isinstance(path, str) else path.as_uri())

    def __enter__(self) -> Exported:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        try:
            if kind is None:
                errors = self.page.evaluate("raystream.opened.then(one => one.errorCount, () => 0)")
                assert not self.problems, self.problems
                assert errors == 0, f"{errors} errors of the GPU"
        finally:
            self.context.close()

    def run(self, script: str, argument: Any = None) -> Any:
        """Evaluate a function of the page's main object and an argument."""
        script = f"async argument => ({script})(await raystream.opened, argument)"
        return self.page.evaluate(script, argument)

    def wait(self, script: str) -> None:
        """Wait until an expression of the page holds."""
        end = time.monotonic() + PATIENCE
        while not self.page.evaluate(script):
            assert time.monotonic() < end, f"waited in vain for {script}: {self.problems}"
            time.sleep(0.02)

    def light_after(self, count: int) -> NDArray[np.float32]:
        """The light of an image of so many samples, made from the first on; see `light`."""
        self.run("(page, count) => { page.scene.samples = count; page.change(); }", count)
        self.wait(f"raystream.opened.then(p => !p.isRunning && p.sample === {count})")
        return self.light()

    def wait_for_samples(self, count: int) -> None:
        """Wait until the image has a number of samples."""
        self.wait(f"raystream.opened.then(page => page.sample >= {count})")

    @property
    def message(self) -> str:
        """What the page tells its visitor."""
        return str(self.page.locator("#message").text_content())

    def light(self) -> NDArray[np.float32]:
        """The mean light of the canvas' pixels, shape (H, W, 3)."""
        words, (width, height) = self.run(
            """async ({gpu, display: {sums, size}}) => [Array.from(new Float32Array(
                await gpu.read(sums, 16 * size[0] * size[1]))), size]"""
        )
        sums = np.array(words, np.float32).reshape(height, width, 4)
        return sums[..., :3] / sums[..., 3:]
