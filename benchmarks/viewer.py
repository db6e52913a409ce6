"""How many images per second the viewer renders with a moving camera.

    python benchmarks/viewer.py --scenes bunny sponza robots:1000000 --seconds 6

A camera orbits each scene at 60 steps per second, as a page would move it, and a simulated page
that shows every frame at once counts the frames. This covers the whole engine, from the message
that moves the camera to the bytes of the image, without a browser and a socket. Also measures how
long a page waits for its first image if the scene is already built, and for that of the resting
camera.
"""

import argparse
import itertools
import math
import statistics
import threading
import time

import numpy as np

import raystream as rs
from raystream.viewer import Frame, RenderService


class Page:
    """A page that shows every frame at once."""

    def __init__(self, service, size):
        self.frames, self.changed = [], threading.Condition()
        self.size = size
        self.began = time.perf_counter()
        self.client = None
        self.client = service.join(self.receive)
        self.client.handle({"type": "size", "width": size[0], "height": size[1]})

    def receive(self, message):
        if isinstance(message, Frame):
            with self.changed:
                self.frames.append((time.perf_counter(), message.header, len(message.content)))
                self.changed.notify_all()
            self.client.handle({"type": "shown", "frame": message.header["number"]})
        elif message["type"] == "error":
            raise SystemExit(message["message"])

    def wait(self, wanted):
        """The first frame that meets a condition: its arrival time and its header."""
        with self.changed:
            find = lambda: next((one for one in self.frames if wanted(one[1])), None)  # noqa: E731
            return self.changed.wait_for(find, 600)

    def display(self, camera, number, moving):
        self.client.handle(
            {
                "type": "camera",
                "number": number,
                "moving": moving,
                "eye": list(camera.eye),
                "look_at": list(camera.look_at),
                "up": list(camera.up),
                "fov": camera.fov,
            }
        )


def around(camera, turn):
    """A camera rotated around the point that it looks at."""
    axis = np.array(camera.up) / np.linalg.norm(camera.up)
    arm = np.subtract(camera.eye, camera.look_at)
    cos, sin = math.cos(turn), math.sin(turn)
    arm = arm * cos + np.cross(axis, arm) * sin + axis * (axis @ arm) * (1.0 - cos)
    return rs.Camera(tuple(camera.look_at + arm), camera.look_at, camera.up, camera.fov)


def orbit(page, camera, seconds):
    """Move the camera for some seconds; the frames after the first half second."""
    end, number = time.perf_counter() + seconds, 0
    begin = len(page.frames)
    while time.perf_counter() < end:
        number += 1
        page.display(around(camera, 0.01 * number), number, True)
        time.sleep(1 / 60)
    frames = [one for one in page.frames[begin:] if one[1]["moving"]]
    first = frames[0][0] + 0.5
    moved = time.perf_counter()
    page.display(around(camera, 0.01 * number), number + 1, False)
    full = page.wait(lambda header: header["camera"] == number + 1 and not header["moving"])
    return [one for one in frames if one[0] > first], full[0] - moved


def measure(name, mode, size, seconds):
    scene = rs.load(name)
    service = RenderService(scene, name, settings={"mode": mode})
    warm = Page(service, size)
    warm.wait(lambda header: not header["moving"] and header["width"] == size[0])
    warm.client.leave()
    page = Page(service, size)
    opened = page.wait(lambda _: True)[0] - page.began
    orbit(page, scene.camera, 2.0)
    frames, rested = orbit(page, scene.camera, seconds)
    times = [one[0] for one in frames]
    gaps = sorted(after - before for before, after in itertools.pairwise(times))
    middle = lambda key: statistics.median(one[1][key] for one in frames)  # noqa: E731
    service.close()
    return {
        "scene": name,
        "fps": (len(times) - 1) / (times[-1] - times[0]),
        "median": 1.0 / statistics.median(gaps),
        "least": 1.0 / gaps[-1 - len(gaps) // 100],
        "width": middle("width"),
        "render": middle("render_ms"),
        "encode": middle("encode_ms"),
        "kB": statistics.median(one[2] for one in frames) / 1e3,
        "first": 1e3 * opened,
        "rested": 1e3 * rested,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scenes", nargs="+", default=["bunny", "sponza", "robots:1000000"])
    parser.add_argument("--mode", default="raycast")
    parser.add_argument("--size", nargs=2, type=int, default=[1024, 768])
    parser.add_argument("--seconds", type=float, default=6.0)
    chosen = parser.parse_args()
    print(
        f"{'scene':16} {'fps':>6} {'median':>7} {'1% low':>7} {'width':>6} {'render':>8} ", end=""
    )
    print(f"{'encode':>8} {'size':>8} {'first':>9} {'rested':>9}")
    for name in chosen.scenes:
        row = measure(name, chosen.mode, tuple(chosen.size), chosen.seconds)
        print(
            f"{row['scene']:16} {row['fps']:6.1f} {row['median']:7.1f} {row['least']:7.1f} "
            f"{row['width']:6.0f} {row['render']:5.1f} ms {row['encode']:5.1f} ms "
            f"{row['kB']:5.0f} kB {row['first']:6.0f} ms {row['rested']:6.0f} ms",
            flush=True,
        )


if __name__ == "__main__":
    main()
