"""Contenders: raystream and its peers behind one interface, imported on demand."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from raystream.bench.contenders.base import Contender, UnavailableError

__all__ = ["PEERS", "Entry", "Peer", "load_contender", "make_contender", "peer_of"]


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
    options : mapping of str to any, optional
        Options of the package.
    for_rays, for_points : bool
        Whether it has queries of rays, and of points.
    """

    adapter: str
    packages: tuple[str, ...]
    install_hint: str
    options: Mapping[str, Any] = MappingProxyType({})
    for_rays: bool = True
    for_points: bool = False


_FOLDER = "raystream.bench.contenders"

_MITSUBA_HINT = (
    "pip install mitsuba; it also needs LLVM's shared library (Debian: libllvm15; elsewhere, set "
    "DRJIT_LIBLLVM_PATH)"
)
_MITSUBA = ("mitsuba", "drjit"), _MITSUBA_HINT
_EMBREEX = f"{_FOLDER}.embreex:Embreex", ("embreex",), "pip install embreex"

#: The peers by name, in the order of the tables' columns.
PEERS: Mapping[str, Peer] = MappingProxyType(
    {
        "open3d": Peer(
            f"{_FOLDER}.open3d:Open3D",
            ("open3d",),
            "pip install open3d; it also needs the system's libusb-1.0, libGL and libgomp",
            for_points=True,
        ),
        "embreex": Peer(*_EMBREEX),
        "embreex-robust": Peer(*_EMBREEX, {"robust": True}),
        "mitsuba": Peer(f"{_FOLDER}.mitsuba:Mitsuba", *_MITSUBA),
        "mitsuba-robust": Peer(
            f"{_FOLDER}.mitsuba:Mitsuba", *_MITSUBA, {"embree_use_robust_intersections": True}
        ),
        "warp": Peer(f"{_FOLDER}.warp:Warp", ("warp",), "pip install warp-lang", for_points=True),
        "fcpw": Peer(
            f"{_FOLDER}.fcpw:Fcpw",
            ("fcpw",),
            "pip install fcpw",
            for_rays=False,
            for_points=True,
        ),
        "libigl": Peer(
            f"{_FOLDER}.libigl:Libigl",
            ("igl",),
            "pip install libigl",
            for_rays=False,
            for_points=True,
        ),
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
    return load_contender(peer_of(entry), entry.options, threads)


def peer_of(entry: Entry) -> Peer:
    """The adapter of an entry: raystream's own, or a peer's."""
    return Peer(_OWN, (), "") if entry.name == "raystream" else PEERS[entry.name]


def load_contender(peer: Peer, options: Mapping[str, Any], threads: int) -> Contender:
    """Import an adapter and prepare it for a build.

    Parameters
    ----------
    peer : Peer
    options : mapping
        In addition to the peer's own.
    threads : int

    Raises
    ------
    UnavailableError
        See `make_contender`; raystream's own errors are raised as they are.
    """
    module, _, kind = peer.adapter.partition(":")
    try:
        adapter: type[Contender] = getattr(importlib.import_module(module), kind)
        return adapter(threads, {**peer.options, **options})
    except (ImportError, OSError, UnavailableError) as error:
        if peer.adapter == _OWN:
            raise
        reason = " ".join(str(error).split())
        raise UnavailableError(f"{reason} ({peer.install_hint})") from error
