"""The cluster: rays and pictures over the workers of a Dask cluster, with one machine's bits.

Needs ``pip install "raystream[cluster]"``. What is here is loaded when it is first asked for.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from raystream.cluster.films import render_frames
    from raystream.cluster.hits import LazyHits, LazyMultiHits
    from raystream.cluster.pictures import render
    from raystream.cluster.tracer import Tracer

__all__ = ["LazyHits", "LazyMultiHits", "Tracer", "render", "render_frames"]

_HOMES = {
    "LazyHits": "hits",
    "LazyMultiHits": "hits",
    "Tracer": "tracer",
    "render": "pictures",
    "render_frames": "films",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'raystream.cluster' has no attribute {name!r}")
    try:
        module = importlib.import_module(f"raystream.cluster.{_HOMES[name]}")
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in ("dask", "distributed"):
            raise
        raise ImportError(
            f'a cluster needs {error.name}: pip install "raystream[cluster]"'
        ) from error
    value = getattr(module, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
