"""Query: a query of rays as data: its kind, options, filter and counters."""

from __future__ import annotations

from enum import IntEnum
from typing import Any, Literal, NamedTuple, get_args

#: A limit that no number of hits reaches.
UNLIMITED = 2**62

#: What a ray exactly through an edge or a vertex hits: see `Tracer.count_hits`.
Crossings = Literal["triangles", "surfaces"]

#: Orders of a ray's hits: see `Tracer.trace`.
Order = Literal["front-to-back", "any"]

_CROSSINGS, _ORDERS = get_args(Crossings), get_args(Order)


class Kind(IntEnum):
    """Kinds of query; shaders know them by these numbers."""

    FIRST_HIT = 0
    ANY_HIT = 1
    COUNT_HITS = 2
    MULTI_HIT = 3
    TRACE = 4


class Query(NamedTuple):
    """A query, the same for each ray of a batch.

    Attributes
    ----------
    kind : Kind
    surfaces : bool
        Whether a ray through an edge or a vertex meets a surface once, rather than every
        triangle there; see `kernels.triangle.intersect`.
    limit : int
        Most hits of a ray that are counted, or found, nearest first.
    is_ordered : bool
        Whether each ray's hits come by increasing t, then prim_id. Otherwise they may come in
        any order, each ray's on one thread.
    on_hit : programs.filters.Filter, callable or None
        The filter that says which hits exist; for `Kind.TRACE` the program to run at them.
    counters : bool
        Whether what each ray meets is counted.
    """

    kind: Kind
    surfaces: bool = False
    limit: int = UNLIMITED
    is_ordered: bool = True
    on_hit: Any = None
    counters: bool = False


def counts_surfaces(crossings: str) -> bool:
    """Whether `crossings` asks for surfaces.

    Raises
    ------
    ValueError
        If it is neither ``"triangles"`` nor ``"surfaces"``.
    """
    _check("crossings", crossings, _CROSSINGS)
    return crossings == "surfaces"


def is_front_to_back(order: str) -> bool:
    """Whether `order` asks for hits by increasing t.

    Raises
    ------
    ValueError
        If it is neither ``"front-to-back"`` nor ``"any"``.
    """
    _check("order", order, _ORDERS)
    return order == "front-to-back"


def _check(name: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise ValueError(f"{name}: expected {' or '.join(map(repr, known))}, got {value!r}")
