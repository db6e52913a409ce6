"""Shapes of users against the engine's own spheres.

    python benchmarks/shapes.py
    python benchmarks/shapes.py --count 10000 --rounds 9

Times first hits and numbers of hits on one thread, of camera rays and of rays in random directions
from random places in the scene: through tori that are written as a `Shape` (a quartic equation),
through balls written so, and through as many spheres of the engine, whose boxes are as large.
Contenders take turns. Prints nanoseconds of a ray, medians of processor time, and their ratios to
those of spheres.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

import raystream as rs

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
import users_shapes as users

SIZE = (320, 240)


def scenes(count: int) -> dict[str, rs.Scene]:
    """By name: in a cube, at a size at which about half of the rays from inside hit a sphere."""
    rng = np.random.default_rng(0)
    places, radius = rng.uniform(-1.0, 1.0, (count, 3)), 1.6 / count**0.5
    tori, balls = np.zeros(count, users.TORUS), np.zeros(count, users.BALL)
    tori["center"] = balls["center"] = places
    tori["major"], tori["minor"] = 0.7 * radius, 0.3 * radius
    balls["radius"] = radius
    return {
        "spheres": rs.Scene.spheres(places, radius),
        "balls": rs.Scene.shapes(users.ball, balls),
        "tori": rs.Scene.shapes(users.torus, tori),
    }


def rays() -> dict[str, tuple[Any, Any]]:
    """By name."""
    rng = np.random.default_rng(1)
    origins, directions = rs.Camera((0.0, 0.0, 4.0), (0.0, 0.0, 0.0)).rays(*SIZE)
    origins = np.broadcast_to(origins, directions.shape).astype(np.float32)
    places = rng.uniform(-1.0, 1.0, (SIZE[0] * SIZE[1], 3)).astype(np.float32)
    return {
        "camera": (np.ascontiguousarray(origins), directions.astype(np.float32)),
        "random": (places, rng.normal(size=places.shape).astype(np.float32)),
    }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--rounds", type=int, default=5)
    given = parser.parse_args()
    rs.set_thread_count(1)
    tracers = {name: rs.Tracer(scene) for name, scene in scenes(given.count).items()}
    for name, (origins, directions) in rays().items():
        for query in ("first_hit", "count_hits"):
            times: dict[str, list[float]] = {one: [] for one in tracers}
            for round_ in range(given.rounds + 1):
                for one, tracer in tracers.items():
                    started = time.thread_time()
                    getattr(tracer, query)(origins, directions)
                    if round_:  # the first one compiles
                        times[one].append(time.thread_time() - started)
            medians = {one: statistics.median(each) for one, each in times.items()}
            shown = [
                f"{one} {1e9 * own / (SIZE[0] * SIZE[1]):.0f} ns ({own / medians['spheres']:.2f})"
                for one, own in medians.items()
            ]
            print(f"{name} {query}: {', '.join(shown)}", flush=True)


if __name__ == "__main__":
    main()
