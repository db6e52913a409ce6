"""The control flow of compiled code: dominators and loops of basic blocks."""

from __future__ import annotations

from collections.abc import Sequence

from raystream.jit.inspect import Instruction

__all__ = ["ControlFlow"]


class ControlFlow:
    """The basic blocks of a function; the first one is the entry.

    Parameters
    ----------
    instructions : sequence of Instruction

    Attributes
    ----------
    ends : list of int
        The terminator of each block.
    after, before : list of tuple of int
        Successors and predecessors of each block.
    dominators : list of int
        The immediate dominator of each block; the entry has itself.
    """

    def __init__(self, instructions: Sequence[Instruction]) -> None:
        count = 1 + max(one.block for one in instructions)
        self.ends = [0] * count
        for k, one in enumerate(instructions):
            self.ends[one.block] = k
        self.after = [instructions[end].blocks for end in self.ends]
        before: list[list[int]] = [[] for _ in range(count)]
        for block, following in enumerate(self.after):
            for number in following:
                before[number].append(block)
        self.before = [tuple(blocks) for blocks in before]
        self.dominators = self._dominators()

    def dominates(self, block: int, other: int) -> bool:
        """Whether a block dominates another."""
        while other != block:
            if self.dominators[other] == other:
                return False
            other = self.dominators[other]
        return True

    def deciders(self, block: int) -> set[int]:
        """The blocks whose terminators decide from which predecessor a block is reached.

        Empty for a loop header: values from the back edge belong to the next iteration, however the
        previous one went.
        """
        if any(self.dominates(block, one) for one in self.before[block]):
            return set()
        top = self.dominators[block]
        found: set[int] = set()
        waiting = list(self.before[block])
        while waiting:
            one = waiting.pop()
            if one in found:
                continue
            found.add(one)
            if one not in (top, block):
                waiting += self.before[one]
        return found

    def loops(self) -> list[set[int]]:
        """The blocks of each outermost loop."""
        bodies: dict[int, set[int]] = {}
        for block, following in enumerate(self.after):
            for head in following:
                if self.dominates(head, block):
                    bodies.setdefault(head, {head}).update(self._body(head, block))
        outer: list[set[int]] = []
        for body in sorted(bodies.values(), key=len, reverse=True):
            if not any(body <= other for other in outer):
                outer.append(body)
        return outer

    def _body(self, head: int, tail: int) -> set[int]:
        """The blocks that reach a back edge without passing the header."""
        found, waiting = {head}, [tail]
        while waiting:
            one = waiting.pop()
            if one not in found:
                found.add(one)
                waiting += self.before[one]
        return found

    def _dominators(self) -> list[int]:
        """Cooper, Harvey and Kennedy, "A Simple, Fast Dominance Algorithm", 2001."""
        order = self._order()
        rank = {block: k for k, block in enumerate(order)}
        above = [-1] * len(self.ends)
        above[0] = 0
        changed = True
        while changed:
            changed = False
            for block in order[1:]:
                new = -1
                for one in self.before[block]:
                    if above[one] < 0:
                        continue
                    new = one if new < 0 else _meet(above, rank, one, new)
                if above[block] != new:
                    above[block], changed = new, True
        return [k if one < 0 else one for k, one in enumerate(above)]

    def _order(self) -> list[int]:
        """Reachable blocks in reverse postorder."""
        seen, order = {0}, []
        stack = [(0, iter(self.after[0]))]
        while stack:
            block, rest = stack[-1]
            for one in rest:
                if one not in seen:
                    seen.add(one)
                    stack.append((one, iter(self.after[one])))
                    break
            else:
                order.append(block)
                stack.pop()
        return order[::-1]


def _meet(above: list[int], rank: dict[int, int], a: int, b: int) -> int:
    """The nearest common dominator of two blocks."""
    while a != b:
        while rank[a] > rank[b]:
            a = above[a]
        while rank[b] > rank[a]:
            b = above[b]
    return a
