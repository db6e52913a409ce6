"""The control flow of compiled code: dominators and loops of basic blocks."""

from __future__ import annotations

from collections.abc import Sequence

import networkx as nx

from raystream.jit.inspect import Instruction


class ControlFlow:
    """The basic blocks of a function; the first one is the entry.

    Parameters
    ----------
    instructions : sequence of Instruction

    Attributes
    ----------
    ends : list of int
        The terminator of each block.
    graph : networkx.DiGraph
        An edge from each block to each of its successors.
    """

    def __init__(self, instructions: Sequence[Instruction]) -> None:
        count = 1 + max(one.block for one in instructions)
        self.ends = [0] * count
        for k, one in enumerate(instructions):
            self.ends[one.block] = k
        self.graph = nx.DiGraph()
        self.graph.add_nodes_from(range(count))
        for block, end in enumerate(self.ends):
            self.graph.add_edges_from((block, one) for one in instructions[end].blocks)
        dominators = nx.immediate_dominators(self.graph, 0)
        self._tree = nx.DiGraph((up, block) for block, up in dominators.items() if block != 0)
        self._tree.add_node(0)

    def dominates(self, block: int, other: int) -> bool:
        """Whether a block dominates another."""
        return block == other or block in self._above(other)

    def deciders(self, block: int) -> set[int]:
        """The blocks whose terminators decide from which predecessor a block is reached.

        Empty for a loop header: values from the back edge belong to the next iteration, however the
        previous one went.
        """
        before = set(self.graph.predecessors(block))
        if not before or any(self.dominates(block, one) for one in before):
            return set()
        (top,) = self._tree.predecessors(block)
        # Paths from the dominator, up to where they meet.
        rest = nx.restricted_view(self.graph, [block], self.graph.in_edges(top))
        return set().union(*(nx.ancestors(rest, one) | {one} for one in before))

    def loops(self) -> list[set[int]]:
        """The blocks of each outermost loop."""
        bodies: dict[int, set[int]] = {}
        for tail, head in self.graph.edges:
            if self.dominates(head, tail):
                bodies.setdefault(head, {head}).update(self._body(head, tail))
        outer: list[set[int]] = []
        for body in sorted(bodies.values(), key=len, reverse=True):
            if not any(body <= other for other in outer):
                outer.append(body)
        return outer

    def _body(self, head: int, tail: int) -> set[int]:
        """The blocks that reach a back edge without passing the header."""
        if head == tail:
            return {head}
        rest = nx.restricted_view(self.graph, [head], [])
        return nx.ancestors(rest, tail) | {tail}

    def _above(self, block: int) -> set[int]:
        return nx.ancestors(self._tree, block) if block in self._tree else set()
