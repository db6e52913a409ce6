"""The multipass machine on the graphics pipeline: each pass runs one fragment program."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.checks import check_choice, check_least
from raystream.core.query import Kind
from raystream.graphics.adapters import OpenDevice
from raystream.graphics.backend import Chunk, GraphicsBackend
from raystream.graphics.errors import GraphicsError
from raystream.graphics.gather_arrays import BUFFERS, MEMORIES
from raystream.graphics.multipass.device_scheduler import DeviceScheduler
from raystream.graphics.multipass.kernels import kernels_of
from raystream.graphics.multipass.kernels.brute_constants import TriangleConstants
from raystream.graphics.multipass.loop_machine import LoopMachine
from raystream.graphics.multipass.loops import (
    MOST_PASSES,
    Batch,
    Work,
    limited,
    run_by_queries,
    run_on_device,
)
from raystream.graphics.multipass.plan import Plan, PlanInputs, make_plan
from raystream.graphics.multipass.ray_loop import LoopStreams, has_targets
from raystream.graphics.multipass.ray_streams import RayStreams
from raystream.graphics.streams.kernel import FragmentKernel
from raystream.graphics.streams.textures import StreamShape
from raystream.graphics.termination import ENDLESS, hit_counts
from raystream.kernels.local_frame import LocalRays
from raystream.machines.backend import Capabilities
from raystream.machines.passes import Passes
from raystream.machines.schedulers import (
    DEFAULT_THRESHOLD,
    SCHEDULERS,
    Scheduler,
    make_scheduler,
)
from raystream.machines.steps import steps_of
from raystream.machines.steps.base import StepKernel
from raystream.streams import Pass
from raystream.structures import Structure

if TYPE_CHECKING:
    from raystream.graphics.rendering import FragmentBands
    from raystream.rendering.integrator import RenderContext

#: Where kernels are chosen: on the device, or on the host by occlusion queries.
LOOPS = ("device", "queries")

#: Most passes of a chunk of rays.
MAX_PASSES = 1 << 20

#: Rays of a chunk: each takes 11 texels, and the number of passes hardly depends on it.
_RAYS_AT_ONCE = 1 << 20

#: Words of a texel.
_TEXEL_WORDS = 4

#: Schedulers that shade only once all rays have ended.
_SHADE_LAST = ("threshold", "naive")


class MultipassBackend(GraphicsBackend):
    """Runs each step of a traversal as a fragment program over all rays that wait for it.

    As `machines.MultipassBackend`, with the same kernels, states, schedulers and passes, but on
    the graphics pipeline (Purcell 2002, section 3; Foley 2005, section 3.4):
    see `graphics.streams`.

    Parameters
    ----------
    structure : Structure
        Built on the CPU; its arrays are copied to the device.
    opened : OpenDevice
    scheduler : {"threshold", "naive", "most-work", "double"} or Scheduler
        How the next kernel is chosen; see `machines.schedulers`. An object needs
        ``loop="queries"``.
    threshold : float
        For ``"threshold"``: the share of the active rays, 0 to 1, that must wait for an
        intersection.
    traversal_steps, intersections : int
        Steps and triangle tests per ray and pass.
    loop : {"device", "queries"}
        Where kernels are chosen: on the device, and the host tests every few dozen passes
        whether rays are left; or on the host, which waits for the counts of each pass. These are
        occlusion queries, as Purcell and Christen used them; not every adapter counts exactly.
        ``"brute"`` then has a triangle in the constants of each draw, as Foley did, if
        `intersections` is 1.
    max_passes : int
        Most passes of a chunk of rays.
    memory : {"buffers", "textures"}
        Where the structure and the scene are, see `graphics.gather_arrays`.
    rays_at_once : int
        Most rays of a chunk.

    Raises
    ------
    GraphicsError
        If the structure is not supported, a kernel does not compile, or it is too large for the
        device. When tracing: if there are more passes than allowed, or counts are not exact.
    ValueError, TypeError
        If an option is out of range.
    """

    capabilities = Capabilities(passes=True, shading=True)

    def __init__(
        self,
        structure: Structure,
        opened: OpenDevice,
        *,
        scheduler: str | Scheduler = "threshold",
        threshold: float = DEFAULT_THRESHOLD,
        traversal_steps: int = 1,
        intersections: int = 1,
        loop: str = "device",
        max_passes: int = MAX_PASSES,
        memory: str = BUFFERS,
        rays_at_once: int = _RAYS_AT_ONCE,
    ) -> None:
        traversal = kernels_of(structure)
        super().__init__(structure, opened, rays_at_once)
        check_choice("loop", loop, LOOPS)
        check_choice("memory", memory, MEMORIES)
        self._host_scheduler = make_scheduler(scheduler, threshold)
        if loop == "device" and not isinstance(scheduler, str):
            known = ", ".join(map(repr, SCHEDULERS))
            raise TypeError(
                f"scheduler: the device supports {known}; {scheduler!r:.60} needs loop='queries'"
            )
        self._scheduler = scheduler
        self._threshold = float(threshold)
        self._traversal = traversal
        self._steps = steps_of(structure)
        self.traversal_steps = check_least("traversal_steps", traversal_steps, 1)
        self.intersections = check_least("intersections", intersections, 1)
        self.max_passes = check_least("max_passes", max_passes, 1)
        self.loop = loop
        self.passes: Passes | None = None
        self._constants = TriangleConstants.if_supported(structure, loop, self.intersections)
        if self._constants is not None:
            self._shaders = self._constants.shaders
        self._latest = Kind.FIRST_HIT
        self._streams = RayStreams(opened, self._shaders, memory)
        self._plans: dict[tuple[Kind, bool, bool], Plan] = {}
        self._device_schedulers: dict[tuple[tuple[int, ...], bool], DeviceScheduler] = {}
        self._plan(Kind.FIRST_HIT, False, False)  # raises for a kernel that does not compile

    def recording(self, passes: Passes) -> MultipassBackend:
        """A copy that records its passes."""
        machine = copy.copy(self)
        machine.passes = passes
        return machine

    def _run(self, chunk: Chunk) -> NDArray[np.uint32]:
        kind, wanted, tallies = chunk.kind, chunk.wanted, chunk.tallies
        self._latest = kind
        counts, is_multi = tallies is not None, kind == Kind.MULTI_HIT
        streams = self._streams
        if is_multi and len(streams.passes.groups) > 1:
            raise GraphicsError(
                f"multipass: {self.opened.adapter} has too few render targets to store several "
                "hits per ray; use machine='compute'"
            )
        begins = wanted[:, 1] != 0 if is_multi else np.full(len(wanted), True)
        if not begins.all():
            return self._run_some(chunk, begins)
        row_count = chunk.row_count if is_multi else 0
        streams.load(chunk.rays, chunk.rows, wanted, row_count, counts)
        streams.rays.write_params(self.structure.triangles.max_coordinate)
        work = Work(
            self.opened,
            streams.passes,
            self._plan(kind, chunk.surfaces, counts),
            streams.bindings(kind, counts),
            len(wanted),
            self._prepare,
        )
        if self._constants is not None:
            self._constants.begin()
        self._loop(work)
        state = streams.rays.state.read_records(len(wanted))
        endings = np.where(state[:, 3] == 0, ENDLESS, state[:, 1] + np.uint32(1))
        found = hit_counts(endings, self._shaders, self.opened)
        if tallies is not None:
            tallies[chunk.rows] += streams.rays.read_tallies()
            self._note_bound()
        return found

    def _run_some(self, chunk: Chunk, begins: NDArray[np.bool_]) -> NDArray[np.uint32]:
        """Trace a chunk without its rays that want no hits."""
        rows = chunk.rows.start + np.flatnonzero(begins)
        some = LocalRays(*(array[rows] for array in chunk.rays))
        tallies = chunk.tallies
        met = None if tallies is None else tallies[rows]
        all_counts = np.zeros(len(chunk.wanted), np.uint32)
        all_counts[begins] = self._run(
            chunk._replace(
                rays=some, rows=slice(0, len(rows)), wanted=chunk.wanted[begins], tallies=met
            )
        )
        if tallies is not None and met is not None:
            tallies[rows] = met
        return all_counts

    def _rows(self, count: int) -> NDArray[Any]:
        return self._streams.rays.read_rows(self._latest, count)

    def _prepare(self, kernel: StepKernel) -> None:
        if self._constants is not None:
            self._constants.load(self._streams.rays, kernel)

    def _loop(self, work: Work) -> None:
        """Pass after pass, until no ray is active."""
        rays = self._streams.rays
        batches = self._batches(work, self._traversal.kernels, rays.count, rays.shape)
        for batch in limited(batches, self.max_passes):
            if self.passes is not None:
                self.passes.draw_count += batch.draw_count
                for kernel, active in batch.passes:
                    self.passes.counters.passes.append(self._pass(kernel, active))

    def _batches(
        self, work: Work, kernels: Sequence[FragmentKernel], count: int, shape: StreamShape
    ) -> Iterator[Batch]:
        """The passes of these kernels on `count` rays, whose streams have this shape."""
        if self.loop == "queries":
            return run_by_queries(work, self._host_scheduler, self._steps.kernels)
        key = tuple(int(one.state) for one in kernels), work.spawns
        if key not in self._device_schedulers:
            self._device_schedulers[key] = DeviceScheduler(
                self.opened,
                kernels,
                str(self._scheduler),
                self._threshold,
                MOST_PASSES,
                spawns=work.spawns,
            )
        scheduler, last = self._device_schedulers[key], len(kernels) - 1
        scheduler.begin(count, shape, work.streams.stencil)
        is_last = self._scheduler in _SHADE_LAST and not work.spawns
        return run_on_device(work, scheduler, range(not work.spawns, last if is_last else last + 1))

    @property
    def _step_constants(self) -> dict[str, float]:
        """Values of ``override`` declarations of the traversal's kernels."""
        return {
            "TRAVERSAL_STEPS": float(self.traversal_steps),
            "INTERSECTIONS": float(self.intersections),
            **self._shaders.constants,
        }

    def loop_machine(self) -> LoopMachine:
        """The machine as renderers' loops run on it."""
        return LoopMachine(
            self._traversal,
            self._shaders,
            self._streams.rays,
            self.structure.triangles.max_coordinate,
            self._step_constants,
            self._loop_batches,
            self.max_passes,
        )

    def _loop_batches(
        self, work: Work, kernels: Sequence[FragmentKernel], streams: LoopStreams
    ) -> Iterator[Batch]:
        """The passes of a renderer's loop: its shading spawns rays."""
        return self._batches(work, kernels, streams.count, streams.shape)

    def bands_on_device(self, context: RenderContext) -> FragmentBands | None:
        """Render samples of an image in loops; see `Tracer.bands_on_device`."""
        if self._constants is not None or not has_targets(self.opened):
            return None
        from raystream.graphics.rendering import FragmentBands

        return FragmentBands(context, self.loop_machine(), self.rays_at_once)

    def _pass(self, number: int, active: int) -> Pass:
        """The counters of a pass: records are texels."""
        one = self._traversal.kernels[number]
        words = active * _TEXEL_WORDS
        return Pass(
            one.name,
            self._streams.rays.count,
            active,
            active,
            dict.fromkeys(one.reads, words),
            dict.fromkeys(one.writes, words),
        )

    def _note_bound(self) -> None:
        if self.passes is not None:
            at_once = {"steps": self.traversal_steps, "tests": self.intersections, "": 1}
            runs = self._streams.rays.read_runs()
            self.passes.add_bound(self._steps.kernels, runs, at_once)

    def _plan(self, kind: Kind, surfaces: bool, counts: bool) -> Plan:
        key = kind, surfaces, counts
        if key not in self._plans:
            rays = self._streams.rays
            inputs = PlanInputs(
                self._shaders,
                rays.instead(kind, counts),
                {"QUERY": float(kind), "SURFACES": float(surfaces), **self._step_constants},
                rays.layouts(kind, counts),
                counts,
                rays.rewrite,
            )
            self._plans[key] = make_plan(self.opened, self._traversal, inputs)
        return self._plans[key]
