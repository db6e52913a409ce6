"""The sequence of nodes that a ray visits with kd-backtrack.

For samples: in plain Python, with float64 where the engine has float32, so that a ray on the edge
of a cell may visit another one. `foley.coherence` reports how many rays do.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from raystream.structures.kdtree.layout import LEAF_AXIS
from raystream.structures.kdtree.structure import KdTreeStructure

#: Zero direction components are replaced by this share of the largest, as in the engine.
_LEAST = 2.0**-40


class NodeVisits(NamedTuple):
    """The nodes at which a ray's steps begin, in order.

    Attributes
    ----------
    down : list of int
        Splits.
    leaves : list of int
    climbs : list of lists of int
        The nodes that each climb reached.
    """

    down: list[int]
    leaves: list[int]
    climbs: list[list[int]]

    @property
    def up(self) -> list[int]:
        """The nodes of all climbs."""
        return [node for climb in self.climbs for node in climb]


class TreeWalker:
    """Traverses a tree with single rays.

    Parameters
    ----------
    tree : KdTreeStructure
    """

    def __init__(self, tree: KdTreeStructure) -> None:
        nodes = tree.tree.nodes
        self._words: list[int] = nodes[:, 1].tolist()
        self._positions: list[float] = nodes[:, 0].view("float32").tolist()
        self._center: list[float] = tree.triangles.center.tolist()
        self._scale = float(tree.triangles.scale)
        self._low, self._high = tree.triangles.bounds.tolist()

    def walk(
        self, origin: Sequence[float], direction: Sequence[float], t_max: float, t_hit: float
    ) -> NodeVisits:
        """Traverse the tree to a ray's first hit.

        Parameters
        ----------
        origin, direction : sequence of three float
            World space.
        t_max : float
            In direction lengths.
        t_hit : float
            Distance of the hit; inf for a miss.
        """
        visits = NodeVisits([], [], [])
        start = [(o - c) * self._scale for o, c in zip(origin, self._center, strict=True)]
        least = _LEAST * max(map(abs, direction))
        along = [d if d else least for d in direction]
        t_in, t_end = self._interval(start, along, t_max * self._scale)
        if not t_in <= t_end or not self._words:
            return visits
        t_end, t_hit = math.nextafter(t_end, math.inf), t_hit * self._scale
        above: list[tuple[int, float]] = []  # the splits from the root, and their ends
        node, t_out = 0, t_end
        while True:
            while self._words[node] & 3 != LEAF_AXIS:
                visits.down.append(node)
                above.append((node, t_out))
                node, t_out = self._child(node, start, along, t_in, t_out)
            visits.leaves.append(node)
            if t_hit < t_out or t_out >= t_end:
                return visits
            t_in = t_out
            climb: list[int] = []
            while not climb or not t_in < t_out:
                node, t_out = above.pop()
                climb.append(node)
            visits.climbs.append(climb)

    def _child(
        self, node: int, start: Sequence[float], along: Sequence[float], t_in: float, t_out: float
    ) -> tuple[int, float]:
        word = self._words[node]
        axis, below = word & 3, word >> 2
        t = (self._positions[node] - start[axis]) / along[axis]
        is_upward = along[axis] > 0.0
        if t <= t_in:
            return below + is_upward, t_out
        return below + (not is_upward), min(t, t_out)

    def _interval(
        self, start: Sequence[float], along: Sequence[float], t_max: float
    ) -> tuple[float, float]:
        t_in, t_out = 0.0, t_max
        for o, d, low, high in zip(start, along, self._low, self._high, strict=True):
            ends = (low - o) / d, (high - o) / d
            t_in, t_out = max(t_in, min(ends)), min(t_out, max(ends))
        return t_in, t_out


def distinct_share(groups: Iterable[Sequence[Sequence[int]]]) -> float:
    """Share of distinct nodes among the visits of a group's rays.

    Parameters
    ----------
    groups : iterable of sequences
        The nodes visited by each ray of a group; repeated visits count once.

    Returns
    -------
    float
        Distinct nodes of groups over the sum of those of rays: 1 if no two rays of a group share a
        node; 1 / n if n rays visit the same nodes; nan without visits.
    """
    distinct = visits = 0
    for rays in groups:
        own = [set(nodes) for nodes in rays]
        distinct += len(set().union(*own))
        visits += sum(map(len, own))
    return distinct / visits if visits else math.nan
