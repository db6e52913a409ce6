"""Contenders: raystream and its peers behind one interface, each imported when it is made."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from raystream.bench.contenders.base import AbsentError, Contender

__all__ = ["PEERS", "Entry", "Peer", "make_contender"]


class Peer(NamedTuple):
    """Where a peer's adapter is, and how to get the peer.

    Parameters
    ----------
    place : str
        Module and class of the adapter.
    packages : tuple of str
        What it imports.
    remedy : str
        What to do where that fails.
    """

    place: str
    packages: tuple[str, ...]
    remedy: str


_FOLDER = "raystream.bench.contenders"

#: The peers by name, in the order of the tables' columns.
PEERS: Mapping[str, Peer] = MappingProxyType(
    {
        "open3d": Peer(
            f"{_FOLDER}.open3d:Open3D",
            ("open3d",),
            "pip install open3d; it also needs the system's libusb-1.0, libGL and libgomp",
        ),
        "embreex": Peer(f"{_FOLDER}.embreex:Embreex", ("embreex",), "pip install embreex"),
        "mitsuba": Peer(
            f"{_FOLDER}.mitsuba:Mitsuba",
            ("mitsuba", "drjit"),
            "pip install mitsuba; it also needs LLVM's shared library (Debian: libllvm15; "
            "elsewhere, let DRJIT_LIBLLVM_PATH name it)",
        ),
        "warp": Peer(f"{_FOLDER}.warp:Warp", ("warp",), "pip install warp-lang"),
        "fcpw": Peer(f"{_FOLDER}.fcpw:Fcpw", ("fcpw",), "pip install fcpw"),
    }
)

#: raystream's own adapter.
_OWN = f"{_FOLDER}.own:Raystream"


class Entry(NamedTuple):
    """Somebody to enter for a benchmark.

    Parameters
    ----------
    label : str
        What the tables call it; no two are alike.
    name : str
        ``"raystream"`` or a key of `PEERS`.
    options : dict
        For raystream: options of its `Tracer`.
    """

    label: str
    name: str
    options: dict[str, Any]


def make_contender(entry: Entry, threads: int) -> Contender:
    """Import a contender and make it ready to build.

    Parameters
    ----------
    entry : Entry
    threads : int
        How many threads it may use.

    Raises
    ------
    AbsentError
        If it is not installed, or what it needs is not: says what to do.
    """
    place = _OWN if entry.name == "raystream" else PEERS[entry.name].place
    module, _, kind = place.partition(":")
    try:
        adapter: type[Contender] = getattr(importlib.import_module(module), kind)
        return adapter(threads, entry.options)
    except (ImportError, OSError, AbsentError) as error:
        if entry.name == "raystream":
            raise
        reason = " ".join(str(error).split())
        raise AbsentError(f"{reason} ({PEERS[entry.name].remedy})") from error
