"""TracedScene: a scene, its structure and the backend that traces it: updated, saved, loaded."""

from __future__ import annotations

import copy
import math
import operator
import time
from collections.abc import Mapping, Sequence
from functools import partial
from os import PathLike
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from raystream.core.choices import DeviceOptions, MachineOptions
from raystream.core.errors import RaystreamError
from raystream.core.masks import ray_masks
from raystream.core.query import Query
from raystream.core.rays import RayArrays, RayBatch, as_integers, broadcast
from raystream.core.scene_kinds import MACHINE_REFUSAL, REFUSALS, check_support
from raystream.jit.threads import Progress
from raystream.kernels.adjacent_rows import rows_of
from raystream.kernels.hits import Sink
from raystream.machines.backend import Backend
from raystream.notebook import html_table
from raystream.scene.mesh import Mesh
from raystream.scene.moving import moved_meshes, same_faces
from raystream.scene.scene import Scene
from raystream.structures import Structure, StructureOptions
from raystream.structures.base import UpdateReport
from raystream.structures.storage import load_structure, save_structure
from raystream.tracer.configuration import Configuration, configure
from raystream.tracer.devices import device_of
from raystream.tracer.figures import figures_of
from raystream.tracer.precision import moved_triangles, of_scene, triangles_of

if TYPE_CHECKING:
    from raystream.machines.counters import RayCounters

#: Attributes that belong to the structure in place, or to the latest query.
_TRANSIENT = ("_backend", "_cast", "_latest", "_world_count")


def flat_ids(name: str, values: Any, count: int, shape: tuple[int, ...]) -> NDArray[np.int32]:
    """One number for each ray, -1 to count - 1, as a flat array."""
    ids = as_integers(name, values)
    if ids.size and not (ids.min() >= -1 and ids.max() < count):
        raise ValueError(f"{name}: expected -1 to {count - 1:,}")
    return np.ascontiguousarray(broadcast(name, ids, shape), np.int32).reshape(-1)


class TracedScene:
    """State of a `Tracer`: everything but its queries.

    Attributes
    ----------
    structure : Structure
        The acceleration structure.
    device, machine : str
    """

    structure: Structure
    device: str
    machine: str
    _scene: Scene | None
    _backend: Backend
    _machine_options: Mapping[str, Any]
    _counts: bool
    _world_count: int
    _latest: RayCounters | None

    def _configure(
        self,
        structure: str | StructureOptions | None,
        device: str | DeviceOptions,
        machine: str | MachineOptions | None,
        counters: bool,
        options: Mapping[str, Any],
    ) -> Configuration:
        """Set all but the structure, which the caller builds or has."""
        configuration = configure(structure, device, machine, options)
        self.device, self.machine = configuration.device, configuration.machine
        self._machine_options = configuration.options
        self._counts = bool(counters)
        return configuration

    def _built(
        self, configuration: Configuration, triangles: Any, progress: Progress | None
    ) -> Structure:
        """Build the structure of triangles; see `_check_kinds`."""
        self._check_kinds(triangles)
        return device_of(self.device).build(
            configuration.structure,
            triangles,
            progress=progress,
            device=configuration.device_options,
        )

    def _check_kinds(self, triangles: Any) -> None:
        """Raise ValueError if the device, machine or counters do not support the kind of scene."""
        machine = f"device={self.device!r}, machine={self.machine!r}"
        check_support(machine, triangles, ValueError)
        if self._counts:
            check_support("counters=True", triangles, ValueError)

    def _set(self, scene: Scene | None, structure: Structure) -> None:
        self._check_kinds(structure.triangles)
        if "structure" in vars(self):
            self.structure.tracers.pop(id(self), None)
        self._scene = scene
        self.structure = structure
        structure.tracers[id(self)] = self
        self._world_count = structure.triangles.world_count
        self._latest = None
        self._backend = device_of(self.device).machines.make(
            self.machine, structure, self._machine_options
        )

    def __getstate__(self) -> dict[str, Any]:
        """All but what is made for the copy of the structure, attributes of subclasses included."""
        return {name: value for name, value in vars(self).items() if name not in _TRANSIENT}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._set(self._scene, self.structure)

    def __copy__(self) -> Self:
        """A copy with a structure of its own, as `update` changes it; the triangles are shared."""
        triangles = self.structure.triangles
        structure = copy.deepcopy(self.structure, {id(triangles): triangles})
        other = type(self).__new__(type(self))
        other.__setstate__({**self.__getstate__(), "structure": structure})
        return other

    @property
    def is_counting(self) -> bool:
        """Whether the tracer was made with ``counters=True``."""
        return self._counts

    @property
    def machine_options(self) -> Mapping[str, Any]:
        """The options of the device and the machine, such as ``scheduler``, that were given."""
        return self._machine_options

    @property
    def counters(self) -> RayCounters:
        """The counters of the latest query's rays.

        Raises
        ------
        ValueError
            If the tracer does not count, or has not run a query yet.
        """
        if not self._counts:
            raise ValueError("counters: this tracer does not count; make it with counters=True")
        if self._latest is None:
            raise ValueError("counters: not available before the first query")
        return self._latest

    @property
    def scene(self) -> Scene:
        """The scene that rays are traced against; bare triangles after `load` without a scene."""
        if self._scene is None:
            self._scene = Scene.from_triangles(self.structure.triangles)
        return self._scene

    def update(
        self,
        vertices: Any = None,
        *,
        transforms: Any = None,
        max_cost_growth: float = 1.5,
        progress: Progress | None = None,
    ) -> UpdateReport:
        """Move the scene's vertices; the faces stay the same.

        Parameters
        ----------
        vertices : array_like of shape (V, 3), real; or a sequence of them; or Scene
            New positions of all vertices, world space, scene units: an array for a scene of
            one mesh, else one for each mesh, or None for a mesh that stays where it is. Or a
            scene with the same faces, such as `Scene.at` returns: its lights, materials, normals
            and camera are also used. If all its meshes are the same objects as before, nothing is
            done, and the report's costs are nan.
            With spheres, shapes or height fields only a scene, with as many of them and samples.
        transforms : array_like of shape (K, 3, 4), real, optional
            Instead of `vertices`, for a scene with instances: their new transforms, see
            `Scene.instances`. The objects stay the same: only the tree over the instances is
            rebuilt. Passing a scene that `Scene.with_transforms` returned does the same.
        max_cost_growth : float
            Refitting a tree to moved triangles is much faster than building it, but the further
            neighbours move apart, the slower the refitted tree is to traverse. It is rebuilt when
            the expected cost of a ray exceeds this multiple of the cost right after the last
            build; 0 rebuilds every time.
        progress : callable, optional
            Called with (triangles placed, triangles) during a rebuild.

        Returns
        -------
        UpdateReport
            Whether the structure was rebuilt, how long the update took, and the costs.

        Raises
        ------
        ValueError
            If the number of meshes, the number of a mesh's vertices or a scene's faces differ,
            or `max_cost_growth` is negative or NaN. Nothing has moved then.
        TypeError
            If the positions are not real numbers.

        Notes
        -----
        Queries then answer as a new tracer of the moved triangles would. The centre and scale that
        float32 coordinates refer to stay as long as float32 rounds the vertices no more coarsely,
        relative to the scene's extent, than in a new tracer: up to 16 extents from the centre.
        Beyond that they are chosen again, and the structure is rebuilt. It is also rebuilt if
        another tracer shares it, see `of_structure`, which keeps the old triangles. Triangles that
        have become degenerate, NaN or infinite are not hit until a later update makes them valid.

        `scene` becomes a scene with the moved vertices; vertices given as arrays do not update
        shading normals. Earlier hits still refer to the old triangles. No query may run in another
        thread meanwhile. An interrupt leaves everything unchanged.

        Examples
        --------
        >>> import numpy as np
        >>> import raystream as rs
        >>> vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)
        >>> tracer = rs.Tracer(rs.Scene.from_arrays(vertices, [[0, 1, 2]]))
        >>> report = tracer.update(vertices + [0, 0, 5])
        >>> report.rebuilt, tracer.first_hit([0.2, 0.2, 0], [0, 0, 1]).t.item()
        (False, 5.0)
        """
        if not max_cost_growth >= 0.0:
            raise ValueError(f"max_cost_growth: expected a number >= 0, got {max_cost_growth}")
        scene = self.scene
        others: Any = vertices if isinstance(vertices, Scene) else scene
        if scene.placements is None and (scene.has_primitives or others.has_primitives):
            return self._update_primitives(vertices, max_cost_growth, progress)
        if (vertices is None) == (transforms is None):
            raise ValueError("update: expected either vertices or transforms")
        if transforms is not None:
            vertices = scene.with_transforms(transforms)
        if scene.placements is not None:
            return self._update_instances(vertices)
        if isinstance(vertices, Scene) and vertices.placements is not None:
            raise ValueError("vertices: the scene has instances, but this tracer's scene has none")
        if isinstance(vertices, Scene):
            meshes: Sequence[Mesh] = same_faces(scene.meshes, vertices.meshes)
            if all(map(operator.is_, scene.meshes, meshes)):
                same = vertices.moved(meshes, of_scene(self.structure.triangles))
                self._set(same, self.structure)
                return UpdateReport(False, 0.0, math.nan, math.nan)
            scene = vertices
        else:
            meshes = moved_meshes(scene.meshes, vertices)
        parts = [(mesh.vertices, mesh.faces) for mesh in meshes]
        triangles = moved_triangles(self.structure.triangles, parts)
        structure, report = self.structure.updated(triangles, max_cost_growth, progress)
        self._set(scene.moved(meshes, of_scene(triangles)), structure)
        triangles.attributes = self.scene.attributes  # those in float64 have none yet
        return report

    def _update_primitives(
        self, scene: Any, max_cost_growth: float, progress: Progress | None
    ) -> UpdateReport:
        """Take another scene of as many primitives: the structure is rebuilt if they moved."""
        own: Any = self.structure.triangles
        if not isinstance(scene, Scene):
            kind = next(iter(own.kinds), "spheres")
            raise ValueError(f"update: positions as arrays are {REFUSALS[kind]}; give a Scene")
        others: Any = scene.triangles
        is_same = own.kinds == others.kinds and np.array_equal(own.mesh_splits, others.mesh_splits)
        if not is_same:
            raise ValueError(
                "update: the scene has other numbers of triangles, samples, spheres or shapes, or "
                "is of another kind; make another tracer"
            )
        if others is self.scene.triangles:
            self._set(scene, self.structure)
            return UpdateReport(False, 0.0, math.nan, math.nan)
        structure, report = self.structure.updated(others, max_cost_growth, progress)
        self._set(scene, structure)
        return report

    def _update_instances(self, scene: Any) -> UpdateReport:
        """Place the instances as in another scene of the same objects."""
        old: Any = self.structure
        if not isinstance(scene, Scene) or scene.placements is None:
            raise ValueError(
                "vertices: move a scene with instances by transforms=, or to a scene that "
                "Scene.with_transforms has returned"
            )
        if not scene.has_objects_of(self.scene):
            raise ValueError("vertices: the scene's objects differ from this tracer's")
        started = time.perf_counter()
        self._set(scene, old.moved(old.triangles.moved(scene.placements)))
        return UpdateReport(True, time.perf_counter() - started, math.nan, math.nan)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the built structure and its triangles to a file.

        In scenes of other kinds than triangles in float32, the file has the geometry and the
        options, and `load` builds the structure again.

        Parameters
        ----------
        path : str or path
            An ``.npz`` file, replaced atomically.

        Raises
        ------
        ValueError
            If the name does not end in ``.npz``.
        OSError
            If it cannot be written.
        """
        save_structure(path, self.structure)

    @classmethod
    def load(
        cls,
        path: str | PathLike[str],
        scene: Scene | None = None,
        device: str | DeviceOptions = "cpu",
        *,
        machine: str | MachineOptions | None = None,
        counters: bool = False,
        **options: Any,
    ) -> Self:
        """Load a structure that `save` wrote.

        Parameters
        ----------
        path : str or path
        scene : Scene, optional
            The scene it was built from, for materials, lights and camera [default: a scene of
            bare triangles].
        device, machine, counters, **options
            As for a new tracer; the options are the device's and the machine's.

        Returns
        -------
        Tracer

        Raises
        ------
        FileFormatError
            If the file is damaged, of another version, or not a saved structure; or if it was
            built from other triangles than those of `scene`.
        """
        if scene is not None and not isinstance(scene, Scene):
            raise TypeError(f"scene: expected a Scene, got {type(scene).__name__}")
        given_in = None if scene is None else partial(triangles_of, scene)
        structure = load_structure(path, given_in)
        given = scene, device
        return cls.of_structure(structure, *given, machine=machine, counters=counters, **options)

    @classmethod
    def of_structure(
        cls,
        structure: Structure,
        scene: Scene | None = None,
        device: str | DeviceOptions = "cpu",
        *,
        machine: str | MachineOptions | None = None,
        counters: bool = False,
        **options: Any,
    ) -> Self:
        """Make a tracer for a structure that has been built already.

        Parameters
        ----------
        structure : Structure
            Any number of tracers may share it: `update` of one leaves the others' triangles alone.
        scene : Scene, optional
            The scene that its triangles come from, for materials, lights and camera.
        device, machine, counters, **options
            As for a new tracer; the options are the device's and the machine's.

        Returns
        -------
        Tracer

        Raises
        ------
        ValueError, TypeError
            If a name is unknown, the machine has no such option, or a tracer's `update` has moved
            the structure's triangles: then that tracer has another structure.
        """
        if structure.is_outdated:
            raise ValueError(
                "structure: Tracer.update has moved its triangles; take the structure that the "
                "updated tracer has now"
            )
        tracer = cls.__new__(cls)
        tracer._configure(None, device, machine, counters, options)
        tracer._set(scene, structure)
        return tracer

    def _rays(
        self,
        origins: Any,
        directions: Any,
        t_min: Any,
        t_max: Any,
        near: Any = None,
        worlds: Any = None,
        mask: Any = None,
    ) -> RayBatch | RayArrays:
        """The rays as flat arrays on the host; or as they are, if the backend reads them."""
        if worlds is not None or self._world_count:
            self._check_for_worlds(worlds)
        if mask is not None:
            self._check_for_masks()
        if self._backend.capabilities.device_arrays and not self._counts:
            arrays = RayArrays(origins, directions, t_min, t_max, worlds, mask)
            if arrays.is_on_gpu():
                if near is not None:
                    raise ValueError("near: expected None for rays on a GPU")
                return arrays
        rays = self.structure.ray_batch(rows_of(origins), rows_of(directions), t_min, t_max)
        if near is not None:
            rays.near = self._checked_sectors(near, rays.shape)
        if worlds is not None:
            rays.worlds = flat_ids("worlds", worlds, self._world_count, rays.shape)
        if mask is not None:
            rays.masks = ray_masks(mask, rays.shape)
        return rays

    def _check_for_masks(self) -> None:
        """Check that the scene and the machine support masks."""
        check_support("mask", self.structure.triangles)
        if not self._backend.capabilities.masks:
            raise RaystreamError(
                f"mask: {MACHINE_REFUSAL} device={self.device!r}, machine={self.machine!r}; use "
                "device='cpu', machine='branching'"
            )

    def _check_for_worlds(self, worlds: Any) -> None:
        """Check that worlds are given if the scene has any, and else not."""
        count = self._world_count
        if not count:
            raise ValueError("worlds: expected None: the scene has no worlds; see Scene.instances")
        if worlds is None:
            raise ValueError(
                f"worlds: expected the world of each ray, 0 to {count - 1:,}, or -1 for none: the "
                "scene's instances are in worlds"
            )

    def _checked_sectors(self, near: Any, shape: tuple[int, ...]) -> NDArray[np.int32]:
        """`near` of `Tracer.first_hit`, flat."""
        is_branching = self.device == "cpu" and self.machine == "branching"
        count = self.structure.sector_count if is_branching else None
        if count is None:
            raise ValueError(
                "near: expected None, since only structure='graph' on the CPU's branching machine "
                "has sectors"
            )
        return flat_ids("near", near, count, shape)

    def _answer(
        self, query: Query, rays: RayBatch, progress: Progress | None, records: Any = None
    ) -> Sink:
        if not self._counts:
            return self._backend.answer(query, rays, progress, records)
        from raystream.machines.counters import answer_counting

        sink, self._latest = answer_counting(self._backend, query, rays, progress)
        return sink

    def __repr__(self) -> str:
        held = self.structure.triangles
        what = "primitives" if held.has_primitives else "triangles"
        placed = held.instances
        instances = "" if placed is None else f", {len(placed):,} instances"
        device = "" if self.device == "cpu" else f", device={self.device!r}"
        is_default = self.machine == device_of(self.device).machines.names[0]
        machine = "" if is_default else f", machine={self.machine!r}"
        return (
            f"Tracer({len(held):,} {what}{instances}, structure={self.structure.name!r}"
            f"{device}{machine})"
        )

    def _repr_html_(self) -> str:
        """Show the structure and its figures in a notebook."""
        return html_table("Tracer", figures_of(self.structure, self._places()))

    def _places(self) -> list[tuple[str, str]]:
        """The machine with its options, and the device."""
        options = self._machine_options.items()
        of_machine = [(f"  {name}", f"{value}") for name, value in options]
        return [("machine", self.machine), *of_machine, ("device", self.device)]
