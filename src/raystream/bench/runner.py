"""Runner: builds and traces with all contenders in turn, and measures times."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeVar

import numpy as np

from raystream.bench.agreement import Agreement, compare, count_hits
from raystream.bench.contenders import Entry, make_contender
from raystream.bench.contenders.base import (
    Contender,
    Geometry,
    Result,
    UnavailableError,
    warmup_geometry,
)
from raystream.bench.contenders.own import Raystream
from raystream.bench.machine import describe_machine
from raystream.bench.memory import measure_memory
from raystream.bench.ray_sets import DEFAULT_SETS, RaySet, make_ray_sets
from raystream.bench.results import NO_QUERY, BenchResult, BuildResult, SceneResult, SetResult
from raystream.jit.threads import Progress
from raystream.scene.scene import Scene

Item = TypeVar("Item")

__all__ = ["Bench", "Plan", "geometry_of"]

#: Contenders that take longer than this for one call, in seconds, are timed in one round only.
MAX_CALL_SECONDS = 10.0

#: Builds are repeated until they took this long in total, in seconds, or once per round.
MAX_BUILD_SECONDS = 3.0


@dataclass(frozen=True)
class Plan:
    """Configuration of a benchmark.

    Attributes
    ----------
    entries : sequence of Entry
        The first is raystream's: it generates the rays, and is the reference for the others.
    sets : sequence of str
        Keys of `RAY_SETS`.
    size : (int, int)
        Image width and height.
    repeats : int
        Rounds after a warm-up round.
    threads : int
    seed : int
    with_memory : bool
        Whether to measure memory: repeats every build in a separate process.
    """

    entries: Sequence[Entry]
    sets: Sequence[str] = DEFAULT_SETS
    size: tuple[int, int] = (1024, 768)
    repeats: int = 5
    threads: int = 1
    seed: int = 0
    with_memory: bool = True


class _Configuration(NamedTuple):
    """One contender in one of its modes."""

    label: str
    mode: str
    contender: Contender


@dataclass
class _StepCounter:
    """Counts a scene's steps for a progress bar."""

    total: int
    report: Progress | None
    done: int = field(default=0)

    def forward(self, count: int = 1) -> None:
        self.done += count
        if self.report is not None:
            self.report(min(self.done, self.total), self.total)


class Bench:
    """A running benchmark; `result` holds the measurements so far at any time.

    Parameters
    ----------
    plan : Plan

    Raises
    ------
    ValueError
        If the first entry is not raystream's.

    Notes
    -----
    In each round every contender runs once, in turn, starting with a different one. A
    disturbance of the machine therefore affects all of them.
    """

    def __init__(self, plan: Plan) -> None:
        if not plan.entries or plan.entries[0].name != "raystream":
            raise ValueError("entries: expected raystream first")
        self._plan = plan
        self.result = BenchResult(describe_machine(plan.threads), plan.size, plan.repeats)
        self._entries: dict[str, Entry] = {}
        self._contenders: dict[str, Contender] = {}

    def open(self) -> None:
        """Import the contenders and try them; unavailable ones are listed as absent.

        Raises
        ------
        ValueError, TypeError
            If an option is not valid for raystream.
        """
        result = self.result
        for entry in self._plan.entries:
            try:
                contender = make_contender(entry, self._plan.threads)
                contender.build(warmup_geometry())  # triggers compilation and loading
                contender.release()
            except UnavailableError as error:
                result.absent[entry.label] = str(error)
                continue
            except Exception as error:  # third-party packages can raise anything
                if entry.name == "raystream":
                    raise
                result.absent[entry.label] = _reason(error)
                continue
            (result.own if entry.name == "raystream" else result.peers).append(entry.label)
            result.versions[entry.label] = contender.version
            if contender.notes:
                result.notes[entry.label] = contender.notes
            self._entries[entry.label] = entry
            self._contenders[entry.label] = contender

    def run(self, name: str, scene: Scene, progress: Progress | None = None) -> None:
        """Measure one scene.

        Parameters
        ----------
        name : str
            Name of the scene in the tables.
        scene : Scene
        progress : callable, optional
            Called with (steps done, steps).
        """
        plan = self._plan
        entry_count = len(self._contenders)
        turns_of_set = sum(len(c.modes) for c in self._contenders.values()) * (plan.repeats + 1)
        total = entry_count * (1 + plan.with_memory) + turns_of_set * len(plan.sets)
        steps = _StepCounter(total, progress)
        geometry = geometry_of(scene)
        found = SceneResult(name, len(geometry.faces))
        self.result.scenes.append(found)
        try:
            self._build(geometry, found, steps)
            own = self._contenders[plan.entries[0].label]
            assert isinstance(own, Raystream)
            width, height = plan.size
            camera = scene.camera_for(width / height)
            for rays in make_ray_sets(own.tracer, camera, plan.size, plan.sets, plan.seed):
                measured = SetResult(rays.name, rays.query, len(rays.rays))
                found.sets.append(measured)
                self._trace(rays, measured, found, steps)
        finally:
            for contender in self._contenders.values():
                contender.release()

    def _build(self, geometry: Geometry, found: SceneResult, steps: _StepCounter) -> None:
        plan, own = self._plan, self._plan.entries[0].label
        if plan.with_memory:
            for label, entry in self._entries.items():
                found.builds[label] = BuildResult()
                found.builds[label].memory = measure_memory(entry, geometry, plan.threads)
                steps.forward()
        for repeat in range(plan.repeats):
            for label, contender in _rotated(list(self._contenders.items()), repeat):
                build = found.builds.setdefault(label, BuildResult())
                is_done = sum(build.seconds) > MAX_BUILD_SECONDS
                if label in found.failures or (repeat and is_done):
                    continue
                contender.release()
                try:
                    build.seconds.append(_timed(contender.build, geometry)[0])
                except Exception as error:  # third-party packages can raise anything
                    if label == own:
                        raise
                    found.failures[label] = _reason(error)
        steps.forward(len(self._contenders))

    def _trace(
        self, rays: RaySet, measured: SetResult, found: SceneResult, steps: _StepCounter
    ) -> None:
        turns = list(self._turns(rays, measured, found))
        rounds = self._plan.repeats
        slow = self._warm_up(rays, measured, turns, steps)
        for number in range(rounds):
            for turn in _rotated(turns, number):
                steps.forward()
                if turn.label in measured.failures or (number and turn in slow):
                    continue
                contender = turn.contender
                seconds, _ = _timed(contender.run, rays.query, rays.rays, turn.mode)
                measured.seconds.setdefault(turn.label, {}).setdefault(turn.mode, []).append(
                    seconds
                )

    def _turns(
        self, rays: RaySet, measured: SetResult, found: SceneResult
    ) -> Iterator[_Configuration]:
        """Iterate over the contenders that support the query."""
        for label, contender in self._contenders.items():
            if label in found.failures:
                measured.failures[label] = found.failures[label]
            elif not len(rays.rays):
                measured.failures[label] = "no rays"
            elif rays.query not in contender.queries:
                measured.failures[label] = NO_QUERY
            else:
                for mode in contender.modes:
                    yield _Configuration(label, mode, contender)

    def _warm_up(
        self,
        rays: RaySet,
        measured: SetResult,
        turns: Sequence[_Configuration],
        steps: _StepCounter,
    ) -> list[_Configuration]:
        """Run each contender once and compare the results; returns the slow ones."""
        slow = []
        reference: Result | None = None
        for turn in turns:
            steps.forward()
            try:
                seconds, result = _timed(turn.contender.run, rays.query, rays.rays, turn.mode)
            except Exception as error:  # third-party packages can raise anything
                if reference is None:
                    raise
                measured.failures[turn.label] = _reason(error)
                continue
            if seconds > MAX_CALL_SECONDS:
                slow.append(turn)
            if reference is None:
                reference = result
                measured.hit_count = count_hits(result)
            else:
                agreement = compare(reference, result)
                before = measured.agreement.get(turn.label, Agreement(0.0, agreement.hits))
                measured.agreement[turn.label] = max(before, agreement)
        return slow


def geometry_of(scene: Scene) -> Geometry:
    """Merge a scene's meshes, as float32 in world space; face indices are `prim_id`.

    Raises
    ------
    ValueError
        If the scene has no triangles, so that there is nothing to compare.
    """
    meshes = [mesh for mesh in scene.meshes if len(mesh.faces)]
    if not meshes:
        raise ValueError("the scene has no triangles")
    firsts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
    return Geometry(
        np.concatenate([mesh.vertices.astype(np.float32, copy=False) for mesh in meshes]),
        np.concatenate([m.faces + np.int32(n) for m, n in zip(meshes, firsts, strict=False)]),
    )


def _timed(call: Callable[..., Item], *arguments: Any) -> tuple[float, Item]:
    gc.collect()
    gc.disable()
    try:
        started = time.perf_counter()
        result = call(*arguments)
        return time.perf_counter() - started, result
    finally:
        gc.enable()


def _rotated(items: Sequence[Item], count: int) -> Sequence[Item]:
    """Rotate items so that each round starts with a different one."""
    first = count % len(items) if items else 0
    return [*items[first:], *items[:first]]


def _reason(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())
