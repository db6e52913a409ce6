"""Tracer: a structure on a machine on a device, answering the queries."""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping, Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any

from raystream.core.choices import DeviceOptions, MachineOptions
from raystream.core.query import Crossings
from raystream.jit.threads import Progress
from raystream.kernels.moving import move_triangles
from raystream.machines.chosen import Chosen, choose
from raystream.machines.devices import device_of
from raystream.machines.queries import Queries
from raystream.notebook import html_table, in_bytes
from raystream.scene.mesh import Mesh
from raystream.scene.moving import moved_meshes, same_faces
from raystream.scene.scene import Scene
from raystream.structures import Structure, StructureOptions
from raystream.structures.base import UpdateReport
from raystream.structures.storage import load_structure, save_structure

if TYPE_CHECKING:
    from raystream.machines import RayCounters

__all__ = ["Crossings", "Tracer"]


class Tracer(Queries):
    """Traces rays against a scene.

    Parameters
    ----------
    scene : Scene
        Its triangles are copied: later changes of the scene's arrays have no effect.
    structure : {"bvh", "kdtree", "graph", "grid", "brute"} or StructureOptions
        Acceleration structure, by its name or as `Bvh`, `KdTree`, `Graph`, `Grid` or `Brute`
        with its options. All return the same bits; ``"brute"`` tests every triangle.
    device : {"cpu", "cuda", "graphics"} or DeviceOptions
        Where rays are traced, by its name or as `Cpu`, `Cuda` or `Graphics` with its options: on
        the processor's cores; on an NVIDIA GPU (``pip install raystream[cuda]``), of several on
        that with the number ``gpu=``; or on a GPU through Vulkan, Metal or Direct3D 12 (``pip
        install raystream[graphics]``).
    machine : {"branching", "multipass", "compute"} or MachineOptions, optional
        How the structure is traversed, by its name or as `Branching`, `Multipass` or `Compute`
        with its options: one ray from start to end on each thread; or all rays step by step, in
        passes (Purcell 2002, section 2.2). All return the same bits on one device;
        ``"multipass"`` is slower, and says how many passes it took. On ``"graphics"`` these two
        are fragment programs, and ``"compute"``, its default, is faster. On the CPU,
        ``"branching"`` is the default.
    counters : bool
        Count what each ray meets: see `counters`. Rays are then traced one by one, without
        the kernels for many rays that ``"bvh"`` has. Not counting costs nothing.
    progress : callable, optional
        Called with (triangles done, triangles) during a long build.
    **options
        Options of what is given by name: ``Tracer(scene, "bvh", quality="high")`` is
        ``Tracer(scene, Bvh(quality="high"))``.

    Raises
    ------
    ValueError
        If a name is unknown or an option is out of range.
    TypeError
        If `scene` is no scene, or the structure has no such option.
    RaystreamError
        If the device is not there, or cannot hold the structure.

    Notes
    -----
    Every query takes rays of any leading shape S: `origins` and `directions` of shape
    S + (3,), which broadcast against each other, of any real dtype, as NumPy arrays or
    anything that converts to one without leaving the CPU (DLPack, ``__array_interface__``).
    World space, scene units; directions need not be unit length, and t counts in their
    lengths. `t_min` and `t_max` are numbers or arrays that broadcast to S; the interval is
    closed, and rounded to float32. A ray with a NaN, infinite or zero direction is no error:
    it misses, and its status is ``RayStatus.INVALID``.

    With ``device="cuda"`` rays may be arrays on the tracer's GPU, by DLPack or
    ``__cuda_array_interface__`` (CuPy, PyTorch, JAX, Numba), of float32 or float64; numbers and
    single vectors may still come from the host. They are read where they are, and must not
    change before that is done: it is in the order of the CUDA stream that they name, else of
    the default one. Answers stay on the GPU, in arrays of their own that such libraries view
    without a copy; ``host()`` makes NumPy's. A query may return before they are filled.

    A ray through a shared edge hits both triangles, never neither [1]_. Degenerate
    triangles, and triangles with a NaN or infinite vertex, are never hit: where one of
    them is all that closes a mesh, the mesh is open.

    Rays are traced on all cores (``RAYSTREAM_THREADS``). Ctrl-C interrupts a query.

    References
    ----------
    .. [1] Woop, Benthin and Wald, "Watertight Ray/Triangle Intersection", Journal of
       Computer Graphics Techniques 2(1), 2013.

    Examples
    --------
    >>> import raystream as rs
    >>> scene = rs.Scene.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    >>> tracer = rs.Tracer(scene)
    >>> hits = tracer.first_hit([[0.25, 0.25, 1], [2, 2, 1]], [0, 0, -1])
    >>> hits.t.tolist(), hits.prim_id.tolist()
    ([1.0, inf], [0, -1])
    """

    def __init__(
        self,
        scene: Scene,
        structure: str | StructureOptions = "bvh",
        device: str | DeviceOptions = "cpu",
        *,
        machine: str | MachineOptions | None = None,
        counters: bool = False,
        progress: Progress | None = None,
        **options: Any,
    ) -> None:
        if not isinstance(scene, Scene):
            raise TypeError(f"scene: expected a Scene, got {type(scene).__name__}; see rs.load")
        chosen = self._choose(structure, device, machine, counters, options)
        built = device_of(self.device).build(
            chosen.structure, scene.triangles, progress=progress, device=chosen.device_options
        )
        self._set(scene, built)

    def _choose(
        self,
        structure: str | StructureOptions | None,
        device: str | DeviceOptions,
        machine: str | MachineOptions | None,
        counters: bool,
        options: Mapping[str, Any],
    ) -> Chosen:
        """Note all but the structure, which the caller builds or has."""
        chosen = choose(structure, device, machine, options)
        self.device, self.machine = chosen.device, chosen.machine
        self._machine_options = chosen.options
        self._counts = bool(counters)
        return chosen

    def _set(self, scene: Scene | None, structure: Structure) -> None:
        self._scene = scene
        self.structure = structure
        self._latest = None
        self._backend = device_of(self.device).machines.make(
            self.machine, structure, self._machine_options
        )

    @property
    def is_counting(self) -> bool:
        """Whether it was made with ``counters=True``."""
        return self._counts

    @property
    def machine_options(self) -> Mapping[str, Any]:
        """The options of the device and the machine, such as ``scheduler``, that were given."""
        return self._machine_options

    @property
    def counters(self) -> RayCounters:
        """What the rays of the latest query met.

        Raises
        ------
        ValueError
            If the tracer does not count, or has not been asked anything yet.
        """
        if not self._counts:
            raise ValueError("counters: this tracer does not count; make it with counters=True")
        if self._latest is None:
            raise ValueError("counters: there are none before the first query")
        return self._latest

    @property
    def scene(self) -> Scene:
        """What rays are traced against; bare triangles after `load` without a scene."""
        if self._scene is None:
            self._scene = Scene.from_triangles(self.structure.triangles)
        return self._scene

    def update(
        self,
        vertices: Any,
        *,
        max_cost_growth: float = 1.5,
        progress: Progress | None = None,
    ) -> UpdateReport:
        """Move the scene's vertices; which triangles they form stays as it is.

        Parameters
        ----------
        vertices : array_like of shape (V, 3), real; or a sequence of them; or Scene
            New positions of all vertices, world space, scene units: an array for a scene of
            one mesh, else one for each mesh, or None for a mesh that stays where it is. Or a
            scene with the same faces, such as `Scene.at` gives: its lights, materials, normals
            and camera then count, too. Where all its meshes are the same objects as before,
            nothing is to be done, and the report's costs are nan.
        max_cost_growth : float
            A tree is adjusted to moved triangles much faster than it is built, but rays take
            longer in it the further neighbours part. It is built anew when the expected cost
            of a ray is more than so many times what it was when it was last built; 0 builds
            it anew every time.
        progress : callable, optional
            Called with (triangles placed, triangles) if it is built anew.

        Returns
        -------
        UpdateReport
            Whether the structure was built anew, how long it took, and its costs.

        Raises
        ------
        ValueError
            If the number of meshes or of vertices of a mesh, or a scene's faces are others,
            or `max_cost_growth` is negative or NaN. Nothing was moved then.
        TypeError
            If the positions are no real numbers.

        Notes
        -----
        Every query then answers as a tracer of the moved triangles would, in the frame that
        this one has: the centre and scale that float32 coordinates refer to stay the same,
        unless a coordinate grew to more than 2**40 times the scale of the scene. Triangles
        that have become degenerate, NaN or infinite are never hit, until they recover.

        `scene` becomes a scene with the moved vertices; shading normals do not follow arrays.
        Hits
        found before still refer to the triangles as they were. No query may run in another
        thread meanwhile. An interrupt leaves everything as it was.

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
        if isinstance(vertices, Scene):
            meshes: Sequence[Mesh] = same_faces(scene.meshes, vertices.meshes)
            if all(map(operator.is_, scene.meshes, meshes)):
                self._set(vertices.moved(meshes, self.structure.triangles), self.structure)
                return UpdateReport(False, 0.0, math.nan, math.nan)
            scene = vertices
        else:
            meshes = moved_meshes(scene.meshes, vertices)
        parts = [(mesh.vertices, mesh.faces) for mesh in meshes]
        triangles = move_triangles(self.structure.triangles, parts)
        structure, report = self.structure.updated(triangles, max_cost_growth, progress)
        self._set(scene.moved(meshes, triangles), structure)
        return report

    def save(self, path: str | PathLike[str]) -> None:
        """Write the built structure and its triangles to a file.

        Parameters
        ----------
        path : str or path
            An ``.npz`` file, replaced as a whole when writing succeeded.

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
    ) -> Tracer:
        """Read a structure that `save` wrote.

        Parameters
        ----------
        path : str or path
        scene : Scene, optional
            The scene it was built of, for its materials, lights and camera. Without it, the
            tracer has a scene of bare triangles.
        device, machine, counters, **options
            As for a new tracer; the options are the device's and the machine's.

        Returns
        -------
        Tracer

        Raises
        ------
        FileFormatError
            If the file is damaged, of another version, or no such file at all; or if it was
            built of other triangles than `scene` has.
        """
        if scene is not None and not isinstance(scene, Scene):
            raise TypeError(f"scene: expected a Scene, got {type(scene).__name__}")
        tracer = cls.__new__(cls)
        tracer._choose(None, device, machine, counters, options)
        structure = load_structure(path, None if scene is None else scene.triangles)
        tracer._set(scene, structure)
        return tracer

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
    ) -> Tracer:
        """Make a tracer of a structure that is built already.

        Parameters
        ----------
        structure : Structure
        scene : Scene, optional
            The scene that its triangles are of, for materials, lights and camera.
        device, machine, counters, **options
            As for a new tracer; the options are the device's and the machine's.

        Returns
        -------
        Tracer

        Raises
        ------
        ValueError, TypeError
            If a name is unknown, or the machine has no such option.
        """
        tracer = cls.__new__(cls)
        tracer._choose(None, device, machine, counters, options)
        tracer._set(scene, structure)
        return tracer

    def __repr__(self) -> str:
        triangle_count = len(self.structure.triangles)
        device = "" if self.device == "cpu" else f", device={self.device!r}"
        is_usual = self.machine == device_of(self.device).machines.names[0]
        machine = "" if is_usual else f", machine={self.machine!r}"
        return (
            f"Tracer({triangle_count:,} triangles, structure={self.structure.name!r}"
            f"{device}{machine})"
        )

    def _repr_html_(self) -> str:
        """Show the structure and its figures in a notebook."""
        structure = self.structure
        triangles, report = structure.triangles, structure.report
        unused = (
            (triangles.degenerate_count, "degenerate"),
            (triangles.nonfinite_count, "not finite"),
        )
        without = ", ".join(f"{count:,} {kind}" for count, kind in unused if count)
        rows = [
            ("triangles", f"{len(triangles):,}" + (f" ({without})" if without else "")),
            ("structure", structure.name),
            *(
                (f"  {name}", f"{value}")
                for name, value in structure.options.as_json().items()
                if value is not None
            ),
            ("machine", self.machine),
            *((f"  {name}", f"{value}") for name, value in self._machine_options.items()),
            ("device", self.device),
            ("build", f"{report.seconds:.3g} s"),
            ("memory", in_bytes(report.byte_count)),
            *((name, f"{value:,.6g}") for name, value in structure.quality().items()),
        ]
        return html_table("Tracer", rows)
