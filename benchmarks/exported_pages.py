"""How soon an exported page shows its first image, in Chromium with software WebGPU.

    python benchmarks/exported_pages.py bunny cornell --rounds 5

Each scene is exported with its BVH alone. Each measurement starts a new browser with an empty
profile, waits for a moment, and then opens the page from disk (with Playwright, of `pip install
raystream[dev]`, and the system's Chromium). Prints the page's size in bytes and the seconds from
opening it until the first sample is on the canvas: medians, with the smallest and the largest.
Scenes take turns, in rounds.
"""

import argparse
import shutil
import statistics
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

import raystream as rs

PROGRAMS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
ARGUMENTS = (
    "--enable-unsafe-webgpu",
    "--use-webgpu-adapter=swiftshader",
    "--use-vulkan=swiftshader",
    "--enable-features=Vulkan",
    "--use-angle=vulkan",
    "--no-sandbox",
)

#: Milliseconds until a new browser has started all its processes.
REST = 3000

#: Records when the page has a sample, by its own clock: frequent polling would load its cores.
WATCH = """
addEventListener("DOMContentLoaded", async () => {
  const page = await raystream.opened;
  const shown = page.shown;
  page.shown = function (...all) {
    shown.apply(this, all);
    window.firstShown ??= performance.now();
  };
  if (page.sample > 0) window.firstShown ??= performance.now();
});
"""


def seconds_to_first(playwright, program, path, size):
    """Seconds from opening a page to its first image."""
    browser = playwright.chromium.launch(executable_path=program, args=ARGUMENTS)
    try:
        page = browser.new_page(viewport={"width": size[0], "height": size[1]})
        page.wait_for_timeout(REST)
        page.add_init_script(WATCH)
        page.goto(path.as_uri())
        while (shown := page.evaluate("window.firstShown ?? null")) is None:
            page.wait_for_timeout(100)
        return shown / 1000  # by the page's clock, which starts with the navigation
    finally:
        browser.close()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", default=["bunny"])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--size", default="256x192", metavar="WxH")
    options = parser.parse_args()
    size = tuple(map(int, options.size.split("x")))
    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        parser.error(f"needs a browser: one of {', '.join(PROGRAMS)}")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        paths = {}
        for name in options.scenes:
            paths[name] = Path(folder, f"{Path(name).stem}.html".replace(":", "-"))
            rs.export_page(rs.load(name), paths[name], structures=["bvh"])
        taken = {name: [] for name in paths}
        for _ in range(options.rounds):
            for name, path in paths.items():
                taken[name].append(seconds_to_first(playwright, program, path, size))
        for name, seconds in taken.items():
            stored = f"{paths[name].stat().st_size:,} bytes"
            middle, least, most = statistics.median(seconds), min(seconds), max(seconds)
            print(f"{name}: {stored}; first image after {middle:.2f} s ({least:.2f} to {most:.2f})")


if __name__ == "__main__":
    main()
