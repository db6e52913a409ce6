"""Runner: builds and traces with all contenders in turn, each in a process of its own."""

from __future__ import annotations

import datetime as dt
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from raystream.bench.agreement import Agreement, compare
from raystream.bench.contender_process import ContenderError, ContenderProcess
from raystream.bench.contenders import Entry, make_contender
from raystream.bench.contenders.base import Geometry, Placed, Rays, warmup_geometry
from raystream.bench.machine import describe_machine
from raystream.bench.memory import Memory
from raystream.bench.ray_sets import DEFAULT_SETS, RAY_SETS, make_ray_sets
from raystream.bench.results import NO_QUERY, BenchResult, BuildResult, SceneResult, SetResult
from raystream.bench.roofline import Peaks, count_tests, measure_peaks
from raystream.bench.worker import OUTCOME, save_geometry, save_rays
from raystream.jit.threads import Progress
from raystream.scene.mesh import Mesh
from raystream.scene.scene import Scene
from raystream.structures.bvh.options import Bvh
from raystream.tracer import Tracer

Item = TypeVar("Item")

#: Rounds before those that count.
WARM_UP_ROUNDS = 1

#: A contender joins no further round of a set after this many seconds of tracing it; everyone
#: joins one that counts.
MAX_SET_SECONDS = 8.0

#: Builds are repeated until they took this long in total, in seconds, or once per round.
MAX_BUILD_SECONDS = 3.0

#: For the estimate: seconds of a contender's start, builds and turns in one scene of a million
#: triangles, and of one call with a million rays; of two cores, the mean of the default scenes.
_SCENE_SECONDS, _CALL_SECONDS = 4.0, 0.3
_ESTIMATED_CORES = 2


@dataclass(frozen=True)
class Plan:
    """Configuration of a benchmark.

    Attributes
    ----------
    entries : sequence of Entry
        The first is raystream's: the others are compared with it.
    sets : sequence of str
        Keys of `RAY_SETS`.
    size : (int, int)
        Image width and height.
    repeats : int
        Rounds after a warm-up round.
    threads : int
    seed : int
    """

    entries: Sequence[Entry]
    sets: Sequence[str] = DEFAULT_SETS
    size: tuple[int, int] = (1024, 768)
    repeats: int = 5
    threads: int = 1
    seed: int = 0

    def settings(self) -> dict[str, Any]:
        """Everything that figures depend on, but for the machine; see `BenchResult`."""
        return {
            "size": list(self.size),
            "sets": list(self.sets),
            "repeats": self.repeats,
            "warm_up_rounds": WARM_UP_ROUNDS,
            "seed": self.seed,
            "entries": [[entry.label, entry.name, entry.options] for entry in self.entries],
        }

    def expected_seconds(self, scene_count: int) -> float:
        """Roughly how long some scenes take, from the sizes alone."""
        width, height = self.size
        calls = len(self.sets) * (self.repeats + WARM_UP_ROUNDS) * width * height / 1e6
        cores = _ESTIMATED_CORES / max(self.threads, 1)
        each = _SCENE_SECONDS + cores * calls * _CALL_SECONDS
        return scene_count * len(self.entries) * each


class OtherContendersError(ValueError):
    """A result cannot be resumed: other contenders are available now, or other versions."""


class _Turn(NamedTuple):
    """One contender in one of its modes."""

    label: str
    mode: str


class _StoredSet(NamedTuple):
    """A ray set in a folder, and what is known of it before it is traced."""

    folder: Path
    measured: SetResult


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

    A context manager: its end ends the contenders' processes.

    Parameters
    ----------
    plan : Plan
    keep : callable, optional
        Called with the result after each ray set and at the end of each scene.
    earlier : BenchResult, optional
        A result to resume: its complete scenes are not measured again.

    Raises
    ------
    ValueError
        If the first entry is not raystream's; or the earlier result has other settings.

    Notes
    -----
    Every scene begins with new processes, so that no contender is affected by what it did before,
    and one that crashed takes part again. In each round every contender runs once, in turn,
    starting with a different one. A disturbance of the machine therefore affects all of them.
    """

    def __init__(
        self,
        plan: Plan,
        keep: Callable[[BenchResult], object] = lambda _: None,
        earlier: BenchResult | None = None,
    ) -> None:
        if not plan.entries or plan.entries[0].name != "raystream":
            raise ValueError("entries: expected raystream first")
        self._plan = plan
        self._keep = keep
        self._processes: dict[str, ContenderProcess] = {}
        self._own = plan.entries[0].label
        machine = describe_machine(plan.threads)
        if earlier is None:
            today = dt.date.today().isoformat()
            self.result = BenchResult(machine, today, plan.settings())
        elif earlier.settings != plan.settings() or earlier.machine != machine:
            raise ValueError(
                "the earlier result has different settings, or is from another machine"
            )
        else:
            self.result = earlier
            earlier.scenes = [scene for scene in earlier.scenes if scene.is_complete]

    def __enter__(self) -> Bench:
        return self

    def __exit__(self, *error: object) -> None:
        self._close()

    def open(self) -> None:
        """Start the contenders; unavailable ones are listed as absent.

        Raises
        ------
        ValueError, TypeError
            If an option is not valid for raystream.
        OtherContendersError
            If the earlier result's scenes were measured with other contenders or versions: their
            figures cannot be compared with new ones.
        ContenderError
            If raystream itself cannot be started.
        """
        plan, result = self._plan, self.result
        for entry in plan.entries:
            if entry.name == "raystream":  # for its own errors
                contender = make_contender(entry, plan.threads)
                contender.build(warmup_geometry())
                contender.release()
        own: list[str] = []
        peers: list[str] = []
        versions: dict[str, str] = {}
        notes: dict[str, str] = {}
        absent: dict[str, str] = {}
        watertight: list[str] = []
        for entry in plan.entries:
            try:
                about = self._start(entry)
            except ContenderError as error:
                if entry.label == self._own:
                    raise
                absent[entry.label] = str(error)
                continue
            (own if entry.name == "raystream" else peers).append(entry.label)
            versions[entry.label] = about["version"]
            if about["watertight"]:
                watertight.append(entry.label)
            if about["notes"]:
                notes[entry.label] = about["notes"]
        if result.scenes and versions != result.versions:
            raise OtherContendersError(
                "the earlier result has different contenders: "
                + _changes(result.versions, versions)
            )
        result.own, result.peers, result.absent = own, peers, absent
        result.versions, result.notes, result.watertight = versions, notes, watertight

    def has(self, name: str) -> bool:
        """Whether a scene has been measured completely."""
        return any(scene.scene == name and scene.is_complete for scene in self.result.scenes)

    def run(self, name: str, scene: Scene, progress: Progress | None = None) -> None:
        """Measure one scene.

        Parameters
        ----------
        name : str
            Name of the scene in the tables.
        scene : Scene
        progress : callable, optional
            Called with (steps done, steps).

        Raises
        ------
        ContenderError
            If raystream itself fails.
        """
        started = time.perf_counter()
        plan = self._plan
        geometry = geometry_of(scene)
        found = SceneResult(name, geometry.triangle_count)
        self.result.scenes.append(found)
        self.result.skipped.pop(name, None)
        steps = _StepCounter(1 + len(plan.sets) * (plan.repeats + 1), progress)
        self._measure_peaks()
        try:
            with tempfile.TemporaryDirectory(prefix="raystream-bench-") as place:
                folder = Path(place)
                save_geometry(folder, geometry)
                del geometry
                stored = self._make_sets(scene, folder)
                self._start_all(found)
                self._build(folder, found)
                steps.forward()
                for one in stored:
                    found.sets.append(one.measured)
                    self._trace(one, found, steps)
                    found.wall_seconds = time.perf_counter() - started
                    self._keep(self.result)
                found.is_complete = True
        finally:
            self._close()
            found.wall_seconds = time.perf_counter() - started
            self._keep(self.result)

    def _measure_peaks(self) -> None:
        """Measure the roofline again, and keep the best: other work makes it lower at times."""
        before, now = self.result.peaks, measure_peaks()
        self.result.peaks = now if before is None else Peaks(*map(max, before, now))

    def _make_sets(self, scene: Scene, folder: Path) -> list[_StoredSet]:
        """Write the ray sets, and count their tests."""
        plan = self._plan
        options = plan.entries[0].options
        is_counted = options.get("structure", "bvh") == "bvh" and "machine" not in options
        kept = {key: options[key] for key in ("quality", "max_leaf_size") if key in options}
        is_counted = is_counted and scene.placements is None
        is_counted = is_counted and kept.get("max_leaf_size", Bvh.max_leaf_size) <= 4
        tracer = Tracer(scene, counters=True, **(kept if is_counted else {}))
        width, height = plan.size
        camera = scene.camera_for(width / height)
        stored = []
        for rays in make_ray_sets(tracer, camera, plan.size, plan.sets, plan.seed):
            measured = SetResult(rays.name, rays.query, len(rays.rays))
            if is_counted and isinstance(rays.rays, Rays) and len(rays.rays):
                measured.counts = count_tests(tracer, rays.query, rays.rays)
            place = folder / rays.name
            place.mkdir()
            save_rays(place, rays.rays)
            stored.append(_StoredSet(place, measured))
        return stored

    def _start(self, entry: Entry) -> dict[str, Any]:
        queries = {RAY_SETS[name].query for name in self._plan.sets}
        process = ContenderProcess(entry, self._plan.threads, queries)
        self._processes[entry.label] = process
        return process.about

    def _start_all(self, found: SceneResult) -> None:
        """Start the contenders that do not run yet."""
        for entry in self._plan.entries:
            if entry.label in self.result.labels and entry.label not in self._processes:
                with self._blaming(entry.label, found.failures):
                    self._start(entry)
        for label, process in self._processes.items():
            found.builds[label] = BuildResult(process.about["seconds"])

    def _close(self) -> None:
        while self._processes:
            self._processes.popitem()[1].close()

    def _blaming(self, label: str, failures: dict[str, str]) -> _Blaming:
        return _Blaming(label, failures, is_fatal=label == self._own)

    def _build(self, folder: Path, found: SceneResult) -> None:
        for repeat in range(self._plan.repeats):
            for label, process in _rotated(list(self._processes.items()), repeat):
                build = found.builds[label]
                is_done = sum(build.seconds) > MAX_BUILD_SECONDS
                if label in found.failures or (repeat and is_done):
                    continue
                with self._blaming(label, found.failures):
                    answer = process.ask("build", folder=str(folder), measured=repeat == 0)
                    build.seconds.append(answer["seconds"])
                    if answer.get("memory") is not None:
                        build.memory = Memory(**answer["memory"])

    def _trace(self, stored: _StoredSet, found: SceneResult, steps: _StepCounter) -> None:
        measured = stored.measured
        turns = list(self._turns(measured, found))
        spent = self._warm_up(stored, turns, found)
        steps.forward()
        for number in range(self._plan.repeats):
            for turn in _rotated(turns, number):
                is_done = spent[turn] > MAX_SET_SECONDS
                if turn.label in measured.failures or (number and is_done):
                    continue
                answer = self._ask(turn, stored, found, keep=None)
                if answer is not None:
                    spent[turn] += answer["seconds"]
                    modes = measured.seconds.setdefault(turn.label, {})
                    modes.setdefault(turn.mode, []).append(answer["seconds"])
            steps.forward()

    def _turns(self, measured: SetResult, found: SceneResult) -> Iterator[_Turn]:
        """Iterate over the contenders that support the query."""
        for label, process in self._processes.items():
            if label in found.failures:
                measured.failures[label] = found.failures[label]
            elif not measured.ray_count:
                measured.failures[label] = "no rays"
            elif measured.query not in process.about["queries"]:
                measured.failures[label] = NO_QUERY
            else:
                for mode in process.about["modes"]:
                    yield _Turn(label, mode)

    def _warm_up(
        self, stored: _StoredSet, turns: Sequence[_Turn], found: SceneResult
    ) -> dict[_Turn, float]:
        """Run each contender once and compare the results; returns the seconds."""
        measured, spent = stored.measured, dict.fromkeys(turns, 0.0)
        reference: NDArray[Any] | None = None
        for turn in turns:
            if turn.label in measured.failures:
                continue
            answer = self._ask(turn, stored, found, keep=str(stored.folder))
            if answer is None:
                continue
            spent[turn] = answer["seconds"]
            measured.warm_up.setdefault(turn.label, {})[turn.mode] = answer["seconds"]
            result = np.load(stored.folder / OUTCOME)
            if reference is None and turn.label == self._own:
                reference = result
                measured.hit_count = answer["hits"]
            elif reference is not None:
                agreement = compare(measured.query, reference, result)
                before = measured.agreement.get(turn.label, Agreement(0.0, agreement.hits))
                measured.agreement[turn.label] = max(before, agreement)
        return spent

    def _ask(
        self, turn: _Turn, stored: _StoredSet, found: SceneResult, keep: str | None
    ) -> dict[str, Any] | None:
        """Let a contender trace a set; None if that fails. A crash ends its part in the scene."""
        measured, process = stored.measured, self._processes[turn.label]
        with self._blaming(turn.label, measured.failures):
            folder, query = str(stored.folder), measured.query
            return process.ask("trace", folder=folder, query=query, mode=turn.mode, keep=keep)
        if not process.is_alive:
            found.failures[turn.label] = measured.failures[turn.label]
        return None


class _Blaming:
    """Notes a contender's failure in the block, by its label."""

    def __init__(self, label: str, failures: dict[str, str], is_fatal: bool) -> None:
        self._label, self._failures, self._is_fatal = label, failures, is_fatal

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: type | None, error: BaseException | None, trace: object) -> bool:
        if not isinstance(error, ContenderError) or self._is_fatal:
            return False
        self._failures[self._label] = str(error)
        return True


def geometry_of(scene: Scene) -> Geometry:
    """Merge a scene's meshes, as float32 in world space; face indices are `prim_id`.

    In a scene with instances, meshes are merged by object.

    Raises
    ------
    ValueError
        If the scene has no triangles, so that there is nothing to compare.
    """
    geometry: Any = scene.geometry
    if scene.placements is not None:
        return _placed_geometry(scene, geometry.mesh_ranges)
    return _merged(scene.meshes)


def _merged(meshes: Sequence[Mesh]) -> Geometry:
    meshes = [mesh for mesh in meshes if len(mesh.faces)]
    if not meshes:
        raise ValueError("the scene has no triangles")
    firsts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
    return Geometry(
        np.concatenate([mesh.vertices.astype(np.float32, copy=False) for mesh in meshes]),
        np.concatenate([m.faces + np.int32(n) for m, n in zip(meshes, firsts, strict=False)]),
    )


def _placed_geometry(scene: Scene, ranges: Sequence[tuple[int, int]]) -> Geometry:
    instances = scene.placements
    assert instances is not None
    objects = [_merged(scene.meshes[first:end]) for first, end in ranges]
    placed = Placed(
        np.cumsum([0, *(len(one.vertices) for one in objects)]),
        np.cumsum([0, *(len(one.faces) for one in objects)]),
        instances.object_ids,
        instances.transforms,
    )
    vertices, faces = (
        np.concatenate([getattr(one, name) for one in objects]) for name in ("vertices", "faces")
    )
    return Geometry(vertices, faces, placed)


def _changes(before: dict[str, str], now: dict[str, str]) -> str:
    """List the contenders that differ, with their versions."""
    labels = [label for label in {**before, **now} if before.get(label) != now.get(label)]
    none = "none"
    return ", ".join(f"{one} {before.get(one, none)} (now {now.get(one, none)})" for one in labels)


def _rotated(items: Sequence[Item], count: int) -> Sequence[Item]:
    """Rotate items so that each round starts with a different one."""
    first = count % len(items) if items else 0
    return [*items[first:], *items[:first]]
