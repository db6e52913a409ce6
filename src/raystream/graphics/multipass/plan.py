"""Plan: the draws of a query's kernels."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.multipass.kernels import STREAMS, TraversalKernels
from raystream.graphics.pipelines import Layout, Program, fragment_pipeline
from raystream.graphics.ray_textures import FRAME
from raystream.graphics.shader_source import shader_source
from raystream.graphics.streams.kernel import FragmentKernel
from raystream.graphics.streams.passes import Draw, groups_of
from raystream.graphics.streams.stencil import Stencil
from raystream.graphics.structures import ShaderStructure
from raystream.graphics.textures import FLOATS, WORDS, sampled

#: Types of the streams that kernels write.
STREAM_TYPES = {"state": "uint32", "found": "float32", "place": "uint32", "span": "float32"}

_FORMATS = {"uint32": WORDS, "float32": FLOATS}

#: Group 0 of a kernel: see multipass/frame.wgsl.
LAYOUT = (*FRAME, *(sampled(_FORMATS[STREAM_TYPES[name]]) for name in STREAMS))

#: Render targets of a program that can write only half of the streams at a time.
_HALVES = ("fragment/targets_found.wgsl", "fragment/targets_place.wgsl")


class PlanInputs(NamedTuple):
    """Inputs of the programs of a query.

    Attributes
    ----------
    shaders : ShaderStructure
        The structure's.
    instead : mapping of str to str
        See `shader_source`.
    constants : mapping of str to float
    layouts : sequence of Layout
        Of the bind groups after the first one.
    counts : bool
        Whether programs count.
    rewrite : callable
        See `RayTextures.rewrite`.
    """

    shaders: ShaderStructure
    instead: Mapping[str, str]
    constants: Mapping[str, float]
    layouts: Sequence[Layout]
    counts: bool
    rewrite: Callable[[str], str]


@dataclass(frozen=True)
class Plan:
    """The draws of a query's kernels.

    Attributes
    ----------
    begin : list of Draw
        For each group of targets; see `streams.passes.groups_of`.
    kernels, commits : list of list of Draw
        For each group of targets, those of the kernels.
    classifies : list of Draw
        One for each next state of each kernel.
    next_states : list of int
        That state.
    """

    begin: list[Draw]
    kernels: list[list[Draw]]
    commits: list[list[Draw]]
    classifies: list[Draw]
    next_states: list[int]

    @property
    def draw_count(self) -> int:
        """Draws of a pass."""
        return sum(map(len, (*self.kernels, *self.commits, self.classifies)))

    def part(self, kernels: Collection[int]) -> Plan:
        """The draws of some kernels."""
        kept = [draw.kernel in kernels for draw in self.classifies]
        return Plan(
            self.begin,
            [[draw for draw in group if draw.kernel in kernels] for group in self.kernels],
            [[draw for draw in group if draw.kernel in kernels] for group in self.commits],
            [draw for draw, is_kept in zip(self.classifies, kept, strict=True) if is_kept],
            [state for state, is_kept in zip(self.next_states, kept, strict=True) if is_kept],
        )


class _PlanBuilder:
    """Builds the draws of a query."""

    def __init__(self, opened: OpenDevice, traversal: TraversalKernels, inputs: PlanInputs) -> None:
        self._opened = opened
        self._inputs = inputs
        self.kernels = traversal.kernels
        self.groups = groups_of(STREAMS, opened)
        shaders = inputs.shaders
        self._sources = self._sources_of(
            lambda instead: inputs.rewrite(
                shaders.source(traversal.shader, instead={**inputs.instead, **instead})
            )
        )
        # Independent of the structure and the query.
        self._shared_sources = self._sources_of(
            lambda instead: shader_source("multipass/commit.wgsl", instead=instead)
        )

    def _sources_of(self, source: Callable[[Mapping[str, str]], str]) -> list[str]:
        """The source for each group of targets."""
        if len(self.groups) == 1:
            return [source({})]
        return [source({"fragment/targets.wgsl": half}) for half in _HALVES]

    def _draw(
        self,
        group: int,
        program: Program,
        stencil: Stencil,
        writes: Sequence[str],
        kernel: int = 0,
    ) -> Draw:
        targets = [(_FORMATS[STREAM_TYPES[name]], name in writes) for name in self.groups[group]]
        name = f"{self._inputs.shaders.shader}, {program.entry}"
        pipeline = fragment_pipeline(self._opened, name, program, targets, stencil)
        return Draw(pipeline, stencil.reference, kernel)

    def kernel(self, group: int, number: int, one: FragmentKernel) -> Draw:
        """The draw of a kernel."""
        constants = {**self._inputs.constants, "KERNEL": float(number)}
        if self._inputs.counts:
            constants["COUNTS"] = float(group == 0)
        layouts = [LAYOUT, *self._inputs.layouts]
        program = Program(self._sources[group], one.entry, layouts, constants)
        return self._draw(group, program, Stencil(one.state), one.writes, number)

    def commit(self, group: int, number: int, one: FragmentKernel) -> Draw:
        """The draw that copies a kernel's results from scratch textures."""
        program = Program(self._shared_sources[group], "commit", [LAYOUT])
        return self._draw(group, program, Stencil(one.state), one.writes, number)

    def begin(self, group: int) -> Draw:
        """The draw that starts all rays."""
        program = Program(self._shared_sources[group], "begin", [LAYOUT])
        stencil = Stencil(None, self.kernels[0].state)
        return self._draw(group, program, stencil, self.groups[group])

    def classify(self, number: int, state: int, next_state: int) -> Draw:
        """The draw that moves rays to their next state."""
        # After all of a kernel's streams have been copied, so in the last group.
        constants = {"NEXT": float(next_state)}
        program = Program(self._shared_sources[-1], "classify", [LAYOUT], constants)
        return self._draw(len(self.groups) - 1, program, Stencil(state, next_state), (), number)

    def of_group(self, make: Any) -> list[list[Draw]]:
        """For each group, draws of the kernels that write to it."""
        return [
            [
                make(group, number, one)
                for number, one in enumerate(self.kernels)
                if set(one.writes) & set(names)
            ]
            for group, names in enumerate(self.groups)
        ]


def make_plan(opened: OpenDevice, traversal: TraversalKernels, inputs: PlanInputs) -> Plan:
    """Build the draws of a query.

    Raises
    ------
    GraphicsError
        If a program does not compile.
    """
    builder = _PlanBuilder(opened, traversal, inputs)
    numbered = list(enumerate(builder.kernels))
    moves = [(number, one.state, to) for number, one in numbered for to in one.transitions]
    return Plan(
        begin=[builder.begin(group) for group in range(len(builder.groups))],
        kernels=builder.of_group(builder.kernel),
        commits=builder.of_group(builder.commit),
        classifies=[builder.classify(*move) for move in moves],
        next_states=[int(to) for _, _, to in moves],
    )
