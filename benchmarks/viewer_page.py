"""The viewer as a user sees it: a browser with its page, and the server on the same cores.

    python benchmarks/viewer_page.py bunny sponza robots:1000000 --rounds 5

For each scene, starts a `raystream view` process and a headless Chromium (with Playwright, of `pip
install raystream[dev]`, and the system's Chromium). The image has 1024 x 768 pixels. Measures:

- how long the first image takes from when the page's address is entered, after one that warmed up
  the server;
- images per second that the page draws while the mouse drags the camera around the scene, compared
  with the server's own timer, with their sizes, and the times of rendering and encoding.

Scenes take turns, in rounds; prints medians, with the smallest and the largest.
"""

import argparse
import json
import re
import shutil
import statistics
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager

SIZE = 1024, 768
PROGRAMS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")

#: Records inside the page when images arrive and are drawn: reporting each to the browser's driver
#: would take cores from the server.
WATCH = """
window.arrived = []; window.drawn = [];
const Plain = window.WebSocket;
window.WebSocket = class extends Plain {
  constructor(...args) {
    super(...args);
    this.addEventListener("message", event => {
      if (typeof event.data === "string") return;
      const length = new DataView(event.data).getUint32(0, true);
      const header = JSON.parse(new TextDecoder().decode(new Uint8Array(event.data, 4, length)));
      window.arrived.push(header);
    });
  }
};
new MutationObserver(changes => {
  if (changes.some(one => one.target.id === "stage")) window.drawn.push(performance.now());
}).observe(document, {subtree: true, attributes: true, attributeFilter: ["data-frame"]});
"""


@contextmanager
def serving(scene):
    """The address of a viewer of a scene."""
    command = [sys.executable, "-m", "raystream", "view", scene, "--port", "0", "--no-open"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        for line in process.stdout:
            if found := re.search(r"http://\S+", line):
                yield found[0]
                return
        sys.exit(f"{scene}: the viewer did not start")
    finally:
        process.terminate()
        process.wait(60)


def look(browser, address, seconds):
    """Open the page, and drag for some seconds; returns times in seconds and image figures."""
    width, height = SIZE
    window = {"width": width + 420, "height": height + 80}
    page = browser.new_page(viewport=window, bypass_csp=True)  # for the scripts below
    page.set_default_timeout(600_000)
    page.add_init_script(WATCH)
    page.goto(f"{address}#size={width}x{height}")
    page.locator("#stage[data-frame]").wait_for()
    page.wait_for_function("window.arrived.some(one => one.done)")
    first = page.evaluate("window.drawn[0]") / 1e3
    box = page.locator("#picture").bounding_box()
    middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(*middle)
    page.mouse.down()
    page.evaluate("() => { window.arrived.length = window.drawn.length = 0; }")
    started = time.perf_counter()
    step = 0
    while time.perf_counter() - started < seconds:
        step += 1
        page.mouse.move(middle[0] + step % 400, middle[1] + (step // 4) % 30)
        time.sleep(0.02)
    spent = time.perf_counter() - started
    drawn = page.evaluate("window.drawn.length")
    arrived = [one for one in page.evaluate("window.arrived") if one["moving"]]
    page.mouse.up()
    page.close()
    middle_one = lambda name: statistics.median(one[name] for one in arrived)  # noqa: E731
    return {
        "first image, s": first,
        "drawn per second": drawn / spent,
        "server's timer": statistics.median(one["fps"] for one in arrived if one["fps"]),
        "width": middle_one("width"),
        "height": middle_one("height"),
        "render, ms": middle_one("render_ms"),
        "encode, ms": middle_one("encode_ms"),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=6.0, help="time to drag in each round")
    parser.add_argument("--json", help="write the figures to this file")
    asked = parser.parse_args()
    from playwright.sync_api import sync_playwright

    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        sys.exit(f"needs a browser: one of {', '.join(PROGRAMS)}")
    figures = {scene: [] for scene in asked.scenes}
    with ExitStack() as stack:
        addresses = {scene: stack.enter_context(serving(scene)) for scene in asked.scenes}
        playwright = stack.enter_context(sync_playwright())
        arguments = ["--disable-gpu", "--no-sandbox"]
        browser = playwright.chromium.launch(executable_path=program, args=arguments)
        for scene, address in addresses.items():
            look(browser, address, 1.0)
            print(f"{scene}: warm", file=sys.stderr)
        for _ in range(asked.rounds):
            for scene, address in addresses.items():
                figures[scene].append(look(browser, address, asked.seconds))
        browser.close()
    for scene, rounds in figures.items():
        print(scene)
        for name in rounds[0]:
            values = [one[name] for one in rounds]
            print(
                f"  {name:16s} {statistics.median(values):8.2f}"
                f"  ({min(values):.2f} to {max(values):.2f})"
            )
    if asked.json:
        with open(asked.json, "w", encoding="utf-8") as file:
            json.dump(figures, file, indent=2)


if __name__ == "__main__":
    main()
