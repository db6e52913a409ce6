"""The cost of shadows, mirrors and paths on the multipass machine (Purcell 2002, section 4.3).

A renderer is one loop: shading gives a pixel its next ray, which goes back to set-up. The runs of
each kernel are counted by the scheduler, and priced by Table 1. The paper's shadow caster
rasterises what the camera sees, so its shadow rays alone are traced.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any, NamedTuple

from raystream.machines import Queues
from raystream.machines.schedulers import Scheduler, make_scheduler
from raystream.rendering.contexts import make_context
from raystream.rendering.integrator import Integrator
from raystream.rendering.render import RENDERERS
from raystream.rendering.sampling.sampler import Sampler
from raystream.tracer import Tracer
from raystream_lab.cost_model import prices

_WORD_BYTES = 4

#: The grid's kernels, and their rows in Table 1.
_KERNELS = {"set up": "set up", "traverse": "step", "intersect": "intersect"}


class CountingScheduler:
    """A scheduler that counts the passes of each kernel, and its runs: a step per ray and pass.

    Parameters
    ----------
    scheduler : Scheduler

    Attributes
    ----------
    passes, runs : Counter
        By the kernel's name.
    """

    def __init__(self, scheduler: Scheduler) -> None:
        self.scheduler = scheduler
        self.passes: Counter[str] = Counter()
        self.runs: Counter[str] = Counter()

    def choose(self, queues: Queues) -> int:
        """See `Scheduler.choose`."""
        chosen = self.scheduler.choose(queues)
        name = queues.kernels[chosen].name
        self.passes[name] += 1
        self.runs[name] += queues.waiting[chosen]
        return chosen


class ShadowRayKeeper(Tracer):
    """A tracer that keeps the shadow rays of an image.

    Attributes
    ----------
    kept : list of (tuple, dict)
        Positional and other arguments of `any_hit`.
    """

    kept: list[tuple[tuple[Any, ...], dict[str, Any]]]

    def any_hit(self, *rays: Any, **options: Any) -> Any:
        """See `Tracer.any_hit`."""
        self.kept.append((rays, options))
        return super().any_hit(*rays, **options)


class LoopRuns(NamedTuple):
    """What an image took on the multipass machine.

    Attributes
    ----------
    runs, passes : dict of str to int
        By kernel.
    stencils : int
        Stencil values that passes read: those of all pixels, in each pass.
    """

    runs: dict[str, int]
    passes: dict[str, int]
    stencils: int


def loop_runs(
    tracer: Tracer, mode: str, options: Mapping[str, Any], size: int, samples: int
) -> LoopRuns:
    """Render a square image as a loop of the multipass machine, and count.

    Parameters
    ----------
    tracer : Tracer
        Of a grid; its structure and scene are used, with the scene's own lights: looking for
        others would trace rays.
    mode : str
        A mode of `render`; or ``"shadow rays"``, those of mode ``"shadow"`` without a loop.
    options : mapping
        Of the mode.
    size, samples : int

    Raises
    ------
    ValueError
        If the renderer cannot be a loop, such as with surfaces that are not opaque.
    """
    counting = CountingScheduler(make_scheduler("threshold"))
    structure, scene = tracer.structure, tracer.scene
    machine = Tracer.of_structure(structure, scene, machine="multipass", scheduler=counting)
    if mode == "shadow rays":
        keeper = ShadowRayKeeper.of_structure(structure, scene)
        keeper.kept = []
        image_of(keeper, "shadow", {}, size, samples)
        stencils = 0
        for rays, own in keeper.kept:
            before = counting.passes.total()
            machine.any_hit(*rays, **own)
            stencils += (counting.passes.total() - before) * size * size
        return LoopRuns(dict(counting.runs), dict(counting.passes), stencils)
    figures = image_of(machine, mode, options, size, samples)
    if "passes" not in figures:
        raise ValueError(f"mode: {mode!r} is no loop in this scene")
    passes = figures["passes"]
    return LoopRuns(dict(counting.runs), passes, sum(passes.values()) * size * size)


def image_of(
    tracer: Tracer, mode: str, options: Mapping[str, Any], size: int, samples: int
) -> Mapping[str, Any]:
    """Trace all rows of an image together, once per sample; returns the figures of its loops."""
    renderer = RENDERERS[mode]
    assert isinstance(renderer, Integrator)
    chosen = renderer.check(renderer.complete(options))
    camera, sampler = tracer.scene.camera_for(1.0), Sampler.of("sobol", 0, samples)
    context = make_context(tracer, camera, (size, size), sampler, chosen, (), "file")
    bands = renderer.bands_of(context)
    for sample in range(samples):
        renderer.trace(context, range(size), sample)
    return bands.figures() if bands else {}


def loop_cost(found: LoopRuns, shaded: Mapping[str, int], eye_count: int) -> dict[str, float]:
    """Rays, passes, instructions and bytes of an image per camera ray, by Table 1.

    Parameters
    ----------
    found : LoopRuns
    shaded : mapping of str to int
        Runs of the kernels of Table 1 that make rays and shade.
    eye_count : int
        Camera rays.
    """
    table = prices("multipass")
    runs = {row: found.runs.get(kernel, 0) for kernel, row in _KERNELS.items()} | dict(shaded)
    words = {name: one.read + one.written + one.memory for name, one in table.items()}
    moved = sum(
        _WORD_BYTES * words[name] * n + table[name].stencil_written * n for name, n in runs.items()
    )
    return {
        "rays": runs["set up"] / eye_count,
        "steps": runs["step"] / eye_count,
        "tests": runs["intersect"] / eye_count,
        "passes": float(sum(found.passes.values())),
        "instructions": sum(table[name].instructions * n for name, n in runs.items()) / eye_count,
        "bytes": (moved + found.stencils) / eye_count,
    }
