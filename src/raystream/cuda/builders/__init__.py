"""Structures built on the device: what takes part is kernels, and sizes that the host must know."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from raystream.cuda.builders.bvh import build_bvh
from raystream.cuda.builders.graph.structure import build_graph
from raystream.cuda.builders.grid import build_grid
from raystream.cuda.builders.kdtree.structure import build_kdtree

__all__ = ["BUILDERS", "build_bvh", "build_graph", "build_grid", "build_kdtree"]


def _with_options(build: Callable[..., Any]) -> tuple[Callable[..., Any], tuple[str, ...]]:
    return build, tuple(inspect.signature(build).parameters)[2:]


#: Builders by the structure's name, and the options that each has.
BUILDERS = {
    "bvh": _with_options(build_bvh),
    "graph": _with_options(build_graph),
    "grid": _with_options(build_grid),
    "kdtree": _with_options(build_kdtree),
}
