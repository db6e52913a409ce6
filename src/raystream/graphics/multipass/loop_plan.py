"""The draws of a renderer's loop: its own kernels, and those of a traversal."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.multipass.kernels import STREAMS, TraversalKernels
from raystream.graphics.multipass.plan import LAYOUT, Plan, PlanInputs
from raystream.graphics.multipass.ray_loop import (
    LOOP_LAYOUT,
    LOOP_STREAMS,
    LOOP_TYPES,
    FragmentLoop,
)
from raystream.graphics.pipelines import Program, fragment_pipeline
from raystream.graphics.shader_source import shader_source
from raystream.graphics.streams.kernel import FragmentKernel
from raystream.graphics.streams.passes import Draw
from raystream.graphics.streams.stencil import Stencil
from raystream.graphics.textures import FLOATS, WORDS
from raystream.machines.records import RayState

_FORMATS = {"uint32": WORDS, "float32": FLOATS}

_COMMIT = shader_source("multipass/commit.wgsl")
_COMMIT_LOOP = shader_source("multipass/loop/commit.wgsl")


def loop_kernels(traversal: TraversalKernels, loop: FragmentLoop) -> tuple[FragmentKernel, ...]:
    """A traversal's kernels with a renderer's shading: they shade all rays."""
    first, *others, _ = traversal.kernels
    starting = tuple(
        RayState.SHADING if state == RayState.DONE else state for state in first.next_states
    )
    spawned = (RayState.STARTING,) if loop.spawns else ()
    stuck = () if loop.grow is None else (RayState.NO_ROOM,)
    shading = FragmentKernel(
        "shade",
        "shade",
        state=RayState.SHADING,
        next_states=(*spawned, RayState.DONE, *stuck),
        reads=(*LOOP_STREAMS, "found"),
        writes=LOOP_STREAMS,
    )
    return first._replace(next_states=starting), *others, shading


def make_loop_plan(
    opened: OpenDevice, traversal: TraversalKernels, inputs: PlanInputs, loop: FragmentLoop
) -> Plan:
    """Build the draws of a loop: in the group of `LOOP_STREAMS`, and in that of the traversal.

    Raises
    ------
    GraphicsError
        If a program does not compile.
    """
    kernels = loop_kernels(traversal, loop)
    shading = len(kernels) - 1
    source = inputs.rewrite(inputs.shaders.source(traversal.shader, instead=inputs.instead))
    own = [LOOP_LAYOUT, loop.layout]

    def draw(
        program: Program,
        stencil: Stencil,
        group: Sequence[str],
        writes: Collection[str],
        kernel: int = 0,
    ) -> Draw:
        targets = [(_FORMATS[LOOP_TYPES[name]], name in writes) for name in group]
        pipeline = fragment_pipeline(opened, program.entry, program, targets, stencil)
        return Draw(pipeline, stencil.reference, kernel)

    def search(number: int, one: FragmentKernel) -> tuple[Draw, Draw]:
        constants = {**inputs.constants, "KERNEL": float(number), "SHADES_ALL": 1.0}
        program = Program(source, one.entry, [LAYOUT, *inputs.layouts], constants)
        commit = Program(_COMMIT, "commit", [LAYOUT])
        stencil = Stencil(one.state)
        return (
            draw(program, stencil, STREAMS, one.writes, number),
            draw(commit, stencil, STREAMS, one.writes, number),
        )

    def classify(number: int, state: int, next_state: int) -> Draw:
        constants: Mapping[str, float] = {"NEXT": float(next_state)}
        program = Program(_COMMIT, "classify", [LAYOUT], constants)
        return draw(program, Stencil(state, next_state), STREAMS, (), number)

    eye = Program(loop.source, "eye_rays", own, loop.constants)
    shade = Program(loop.source, "shade", own, loop.constants)
    commit = Program(_COMMIT_LOOP, "commit", own)
    at = Stencil(RayState.SHADING)
    searches = [search(number, one) for number, one in enumerate(kernels[:-1])]
    moves = [
        (number, one.state, state)
        for number, one in enumerate(kernels)
        for state in one.transitions
    ]
    return Plan(
        begin=[draw(eye, Stencil(None, RayState.STARTING), LOOP_STREAMS, LOOP_STREAMS)],
        kernels=[
            [draw(shade, at, LOOP_STREAMS, LOOP_STREAMS, shading)],
            [kernel for kernel, _ in searches],
        ],
        commits=[
            [draw(commit, at, LOOP_STREAMS, LOOP_STREAMS, shading)],
            [done for _, done in searches],
        ],
        classifies=[classify(*move) for move in moves],
        next_states=[int(state) for _, _, state in moves],
    )


def make_resuming_draw(opened: OpenDevice) -> Draw:
    """The draw that returns pixels without room to shading, once they have more."""
    stencil = Stencil(RayState.NO_ROOM, RayState.SHADING)
    targets: list[tuple[Any, bool]] = [(_FORMATS[LOOP_TYPES[name]], False) for name in STREAMS]
    program = Program(_COMMIT, "resume", [LAYOUT])
    return Draw(
        fragment_pipeline(opened, "resume", program, targets, stencil), stencil.reference, 0
    )
