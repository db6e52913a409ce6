"""Runner: builds and traces with all contenders in turn, and keeps the time."""

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
    AbsentError,
    Answer,
    Contender,
    Geometry,
    practice_geometry,
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

#: Who took longer than this for one call takes part in one round only, seconds.
PATIENCE = 10.0

#: Builds are repeated until they took this long together, seconds, or as often as rounds are.
BUILD_PATIENCE = 3.0


@dataclass(frozen=True)
class Plan:
    """What to measure.

    Attributes
    ----------
    entries : sequence of Entry
        The first is raystream's: it finds where rays start, and others are compared with it.
    sets : sequence of str
        Keys of `RAY_SETS`.
    size : (int, int)
        Width and height of the pictures.
    repeats : int
        Rounds after one for warming up.
    threads : int
    seed : int
    with_memory : bool
        Whether to measure memory: builds everything once more, each in its own process.
    """

    entries: Sequence[Entry]
    sets: Sequence[str] = DEFAULT_SETS
    size: tuple[int, int] = (1024, 768)
    repeats: int = 5
    threads: int = 1
    seed: int = 0
    with_memory: bool = True


class _Turn(NamedTuple):
    """One contender in one of its modes."""

    label: str
    mode: str
    contender: Contender


@dataclass
class _Steps:
    """Counts a scene's steps for a progress bar."""

    total: int
    report: Progress | None
    done: int = field(default=0)

    def forward(self, count: int = 1) -> None:
        self.done += count
        if self.report is not None:
            self.report(min(self.done, self.total), self.total)


class Bench:
    """A benchmark in progress; what is measured so far is in `result`, at any time.

    Parameters
    ----------
    plan : Plan

    Raises
    ------
    ValueError
        If the first entry is not raystream's.

    Notes
    -----
    In each round every contender does the same once, one after another; each round begins
    with another one. So what disturbs the machine for a while disturbs all of them.
    """

    def __init__(self, plan: Plan) -> None:
        if not plan.entries or plan.entries[0].name != "raystream":
            raise ValueError("entries: expected raystream first")
        self._plan = plan
        self.result = BenchResult(describe_machine(plan.threads), plan.size, plan.repeats)
        self._entries: dict[str, Entry] = {}
        self._contenders: dict[str, Contender] = {}

    def open(self) -> None:
        """Import the contenders, and try them; those that are not there are listed as absent.

        Raises
        ------
        ValueError, TypeError
            If an option does not suit raystream.
        """
        result = self.result
        for entry in self._plan.entries:
            try:
                contender = make_contender(entry, self._plan.threads)
                contender.build(practice_geometry())  # what is compiled or loaded once
                contender.release()
            except AbsentError as error:
                result.absent[entry.label] = str(error)
                continue
            except Exception as error:  # anything, from a package of others
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
            What the tables call it.
        scene : Scene
        progress : callable, optional
            Called with (steps done, steps).
        """
        plan = self._plan
        entry_count = len(self._contenders)
        turns_of_set = sum(len(c.modes) for c in self._contenders.values()) * (plan.repeats + 1)
        total = entry_count * (1 + plan.with_memory) + turns_of_set * len(plan.sets)
        steps = _Steps(total, progress)
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

    def _build(self, geometry: Geometry, found: SceneResult, steps: _Steps) -> None:
        plan, own = self._plan, self._plan.entries[0].label
        if plan.with_memory:
            for label, entry in self._entries.items():
                found.builds[label] = BuildResult()
                found.builds[label].memory = measure_memory(entry, geometry, plan.threads)
                steps.forward()
        for repeat in range(plan.repeats):
            for label, contender in _rotated(list(self._contenders.items()), repeat):
                build = found.builds.setdefault(label, BuildResult())
                is_done = sum(build.seconds) > BUILD_PATIENCE
                if label in found.failures or (repeat and is_done):
                    continue
                contender.release()
                try:
                    build.seconds.append(_timed(contender.build, geometry)[0])
                except Exception as error:  # anything, from a package of others
                    if label == own:
                        raise
                    found.failures[label] = _reason(error)
        steps.forward(len(self._contenders))

    def _trace(self, rays: RaySet, measured: SetResult, found: SceneResult, steps: _Steps) -> None:
        turns = list(self._turns(rays, measured, found))
        rounds = self._plan.repeats
        slow = self._warm_up(rays, measured, turns, steps)
        for number in range(rounds):
            for turn in _rotated(turns, number):
                steps.forward()
                if turn.label in measured.failures or (number and turn in slow):
                    continue
                contender = turn.contender
                seconds, _ = _timed(contender.ask, rays.query, rays.rays, turn.mode)
                measured.seconds.setdefault(turn.label, {}).setdefault(turn.mode, []).append(
                    seconds
                )

    def _turns(self, rays: RaySet, measured: SetResult, found: SceneResult) -> Iterator[_Turn]:
        """Those that can answer."""
        for label, contender in self._contenders.items():
            if label in found.failures:
                measured.failures[label] = found.failures[label]
            elif not len(rays.rays):
                measured.failures[label] = "no rays"
            elif rays.query not in contender.queries:
                measured.failures[label] = NO_QUERY
            else:
                for mode in contender.modes:
                    yield _Turn(label, mode, contender)

    def _warm_up(
        self, rays: RaySet, measured: SetResult, turns: Sequence[_Turn], steps: _Steps
    ) -> list[_Turn]:
        """Let each answer once; compare the answers. Returns the turns that take long."""
        slow = []
        reference: Answer | None = None
        for turn in turns:
            steps.forward()
            try:
                seconds, answer = _timed(turn.contender.ask, rays.query, rays.rays, turn.mode)
            except Exception as error:  # anything, from a package of others
                if reference is None:
                    raise
                measured.failures[turn.label] = _reason(error)
                continue
            if seconds > PATIENCE:
                slow.append(turn)
            if reference is None:
                reference = answer
                measured.hit_count = count_hits(answer)
            else:
                agreement = compare(reference, answer)
                before = measured.agreement.get(turn.label, Agreement(0.0, agreement.hits))
                measured.agreement[turn.label] = max(before, agreement)
        return slow


def geometry_of(scene: Scene) -> Geometry:
    """Put a scene's meshes together, as float32 in world space; faces are `prim_id`.

    Raises
    ------
    ValueError
        If the scene has no triangles: there would be nothing to compare.
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
        answer = call(*arguments)
        return time.perf_counter() - started, answer
    finally:
        gc.enable()


def _rotated(items: Sequence[Item], count: int) -> Sequence[Item]:
    """Begin with another one in every round."""
    first = count % len(items) if items else 0
    return [*items[first:], *items[:first]]


def _reason(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())
