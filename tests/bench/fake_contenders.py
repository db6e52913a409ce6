"""Contenders for tests of the runner: their own processes import them from here."""

from __future__ import annotations

import contextlib
import os
import signal
import stat
import sys
import time

import numpy as np

from raystream.bench.contenders.base import FirstHits, UnavailableError
from raystream.bench.contenders.own import Raystream

#: The adapters that `adopt` makes peers of.
KINDS = ("Nearsighted", "Broken", "Crashing", "Killed", "Missing", "Silent", "Interrupted")


class Nearsighted(Raystream):
    """Cannot find all hits, and none beyond a distance."""

    modes = ("near", "far")
    queries = frozenset(("first", "any"))
    notes = "does not see far"

    def __init__(self, threads, options):  # noqa: ARG002
        super().__init__(threads, {})

    def first_hit(self, rays, mode):
        print("to the standard output, which is the bench's")  # noqa: T201
        hits = super().first_hit(rays, mode)
        return hits if mode == "far" else FirstHits(np.full_like(hits.t, np.inf), hits.prim_id)


class Broken(Nearsighted):
    modes = ("",)

    def build(self, geometry):
        if len(geometry.faces) == 12:
            raise RuntimeError("no\nboxes")
        super().build(geometry)


class Crashing(Nearsighted):
    """Ends its process when asked for many any hits."""

    modes = ("",)

    def any_hit(self, rays, mode):
        if len(rays) < 1000:
            print("too much\nfor me", file=sys.stderr, flush=True)  # noqa: T201
            os._exit(3)
        return super().any_hit(rays, mode)


class Killed(Nearsighted):
    """Is killed while it builds a large scene, as by the system when memory is short."""

    modes = ("",)

    def build(self, geometry):
        if len(geometry.faces) == 12:
            os.kill(os.getpid(), signal.SIGKILL)
        super().build(geometry)


class Missing(Nearsighted):
    def __init__(self, threads, options):  # noqa: ARG002
        raise UnavailableError("not today")


class Silent(Nearsighted):
    """Does not answer."""

    modes = ("",)

    def first_hit(self, rays, mode):
        if len(rays) < 1000:
            time.sleep(600.0)
        return super().first_hit(rays, mode)


class Interrupted(Nearsighted):
    """Is killed in the middle of an answer."""

    modes = ("",)

    def first_hit(self, rays, mode):
        if len(rays) < 1000:
            for number in range(3, 64):  # the copy of the standard output that answers go to
                with contextlib.suppress(OSError):
                    if stat.S_ISFIFO(os.fstat(number).st_mode):
                        os.write(number, b'{"seconds": 1.')
            os.kill(os.getpid(), signal.SIGKILL)
        return super().first_hit(rays, mode)
