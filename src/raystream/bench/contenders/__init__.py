"""Contenders: raystream and its peers behind one interface, imported on demand."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from raystream.bench.contenders.base import Contender, UnavailableError

__all__ = ["PEERS", "Entry", "Peer", "make_contender"]


class Peer(NamedTuple):
    """A peer's adapter, and how to install the peer.

    Parameters
    ----------
    adapter : str
        Module and class of the adapter.
    packages : tuple of str
        Packages it imports.
    install_hint : str
        Installation hint, shown if the import fails.
    """

    adapter: str
    packages: tuple[str, ...]
    install_hint: str


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
            "elsewhere, set DRJIT_LIBLLVM_PATH)",
        ),
        "warp": Peer(f"{_FOLDER}.warp:Warp", ("warp",), "pip install warp-lang"),
        "fcpw": Peer(f"{_FOLDER}.fcpw:Fcpw", ("fcpw",), "pip install fcpw"),
    }
)

#: raystream's own adapter.
_OWN = f"{_FOLDER}.own:Raystream"


class Entry(NamedTuple):
    """An entry of a benchmark.

    Parameters
    ----------
    label : str
        Its unique name in the tables.
    name : str
        ``"raystream"`` or a key of `PEERS`.
    options : dict
        `Tracer` options, for raystream only.
    """

    label: str
    name: str
    options: dict[str, Any]


def make_contender(entry: Entry, threads: int) -> Contender:
    """Import a contender and prepare it for a build.

    Parameters
    ----------
    entry : Entry
    threads : int
        Number of threads it may use.

    Raises
    ------
    UnavailableError
        If it or one of its requirements is not installed; the message says what to do.
    """
    place = _OWN if entry.name == "raystream" else PEERS[entry.name].adapter
    module, _, kind = place.partition(":")
    try:
        adapter: type[Contender] = getattr(importlib.import_module(module), kind)
        return adapter(threads, entry.options)
    except (ImportError, OSError, UnavailableError) as error:
        if entry.name == "raystream":
            raise
        reason = " ".join(str(error).split())
        raise UnavailableError(f"{reason} ({PEERS[entry.name].install_hint})") from error
