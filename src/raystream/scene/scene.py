"""Scene: meshes with materials, lights and a camera."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raystream.core.triangles import Triangles
from raystream.notebook import html_table
from raystream.scene.animation import FPS, Animation, Timeline
from raystream.scene.camera import Camera, unit_vector
from raystream.scene.camera_track import CameraMotion
from raystream.scene.lights import AreaLight, Light
from raystream.scene.material import Color, Material
from raystream.scene.mesh import Mesh

__all__ = ["Scene"]


class Scene:
    """What rays are traced against, and what a picture of it needs.

    Parameters
    ----------
    meshes : sequence of Mesh
        Their triangles are numbered one mesh after another: `prim_id` counts over them all.
    materials : sequence of Material, optional
        What each mesh's ``material_ids`` refer to; without any, one grey material.
    lights : sequence of PointLight, DirectionalLight or EnvironmentLight, optional
        Area lights are not listed: they follow from emissive materials.
    camera : Camera, optional
        The view to use when a caller names none; without it, that of the track while it
        stands still, else one that frames the scene.
    camera_track : CameraTrack, optional
        How the camera moves; see `camera_at`.
    cameras : mapping of str to Camera or CameraTrack, optional
        All views that it has, by name; see `use_camera`. The first is `camera` and
        `camera_track`, if neither is given.
    animation : Animation, optional
        How meshes and lights move; see `at`.
    up : array_like of shape (3,), optional
        The world's up direction, used to frame the scene.
    background : Color, optional
        What rays that miss see, linear RGB.
    name : str, optional
        For people.

    Raises
    ------
    ValueError
        If a mesh refers to a material that is not there, or `up` is zero.
    """

    def __init__(
        self,
        meshes: Sequence[Mesh] = (),
        *,
        materials: Sequence[Material] = (),
        lights: Sequence[Light] = (),
        camera: Camera | None = None,
        camera_track: CameraMotion | None = None,
        cameras: Mapping[str, Camera | CameraMotion] | None = None,
        animation: Animation | None = None,
        up: ArrayLike = (0.0, 1.0, 0.0),
        background: Color = (0.0, 0.0, 0.0),
        name: str = "",
    ) -> None:
        self.meshes = tuple(meshes)
        self.materials = tuple(materials) or (Material(),)
        self.lights = tuple(lights)
        self.name = str(name)
        self.up = unit_vector("up", up)
        self.background = background
        self._camera = camera_track.still if camera is None and camera_track else camera
        self._camera_track = camera_track
        self._cameras = dict(cameras or {})
        self._animation = animation
        if self._camera is None and self._cameras:
            self.use_camera(0)
        self._triangles: Triangles | None = None
        for index, mesh in enumerate(self.meshes):
            if len(mesh.faces) and int(mesh.material_ids.max()) >= len(self.materials):
                raise ValueError(
                    f"mesh {index} ({mesh.name!r}) uses material {int(mesh.material_ids.max())}, "
                    f"but the scene has {len(self.materials)}"
                )

    @classmethod
    def from_arrays(cls, vertices: ArrayLike, faces: ArrayLike, **attributes: Any) -> Scene:
        """Make a scene of one mesh.

        Parameters
        ----------
        vertices : array_like of shape (V, 3), float
            Positions in world space.
        faces : array_like of shape (F, 3), integer
            Vertex indices of each triangle.
        **attributes
            ``normals``, ``colors``, ``texcoords``, ``material_ids``, ``name``: see `Mesh`.

        Returns
        -------
        Scene

        Raises
        ------
        ValueError, TypeError
            If an array's shape, dtype or index range is wrong.

        Examples
        --------
        >>> import raystream as rs
        >>> scene = rs.Scene.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
        >>> scene.triangle_count
        1
        """
        return cls([Mesh(vertices, faces, **attributes)])

    @classmethod
    def from_triangles(cls, triangles: Triangles) -> Scene:
        """Make a scene of a triangle store: the same triangles and meshes, and nothing else."""
        corners = triangles.to_world(triangles.corners)
        meshes = []
        for first, end in itertools.pairwise(triangles.mesh_splits):
            faces = np.arange(3 * (end - first), dtype=np.int32).reshape(-1, 3)
            meshes.append(Mesh(corners[first:end].reshape(-1, 3), faces))
        scene = cls(meshes)
        scene._triangles = triangles
        return scene

    def moved(self, meshes: Sequence[Mesh], triangles: Triangles) -> Scene:
        """Make the same scene with moved meshes.

        Parameters
        ----------
        meshes : sequence of Mesh
            As many, with the same faces.
        triangles : Triangles
            Theirs.
        """
        scene = Scene.__new__(Scene)
        scene.__dict__.update(self.__dict__)
        scene.meshes, scene._triangles = tuple(meshes), triangles
        return scene

    @property
    def triangles(self) -> Triangles:
        """The triangles of all meshes in the form that structures are built from; made once."""
        if self._triangles is None:
            self._triangles = Triangles([(mesh.vertices, mesh.faces) for mesh in self.meshes])
        return self._triangles

    @property
    def triangle_count(self) -> int:
        """Number of triangles over all meshes, skipped ones included."""
        return sum(len(mesh.faces) for mesh in self.meshes)

    @property
    def skipped_count(self) -> int:
        """Number of triangles that can never be hit: degenerate, or with a non-finite vertex."""
        triangles = self.triangles
        return triangles.degenerate_count + triangles.nonfinite_count

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Corners of the box around all triangles that can be hit.

        Returns
        -------
        ndarray of shape (2, 3), float64
            Rows: low and high, world space; both zero for a scene with nothing to hit.
        """
        return self.triangles.world_bounds

    @property
    def camera(self) -> Camera:
        """The scene's own camera, else one that frames its bounds in a picture of 4:3."""
        return self.camera_for(4.0 / 3.0)

    @camera.setter
    def camera(self, camera: Camera) -> None:
        self._camera, self._camera_track = camera, None

    @property
    def has_own_camera(self) -> bool:
        """Whether the camera was given, and does not just frame the bounds."""
        return self._camera is not None

    def camera_for(self, aspect: float) -> Camera:
        """The scene's own camera, else one that frames its bounds in such a picture.

        Parameters
        ----------
        aspect : float
            Width of the picture over its height.
        """
        if self._camera is not None:
            return self._camera
        low, high = self.bounds
        return Camera.framing(low, high, up=self.up, aspect=aspect)

    @property
    def cameras(self) -> dict[str, Camera]:
        """The views that the scene came with, by name, while they stand still."""
        return {
            name: one if isinstance(one, Camera) else one.still
            for name, one in self._cameras.items()
        }

    def use_camera(self, which: str | int) -> None:
        """Look from one of `cameras` from now on; it may move.

        Parameters
        ----------
        which : str or int
            Its name, or its number from 0.

        Raises
        ------
        ValueError
            If there is none of that name or number.
        """
        names = list(self._cameras)
        if isinstance(which, int) and 0 <= which < len(names):
            which = names[which]
        if which not in self._cameras:
            shown = ", ".join(f"{name[:40]!r} ({i})" for i, name in enumerate(names[:10]))
            there = f"the scene has {shown}" if names else "the scene has none to choose from"
            raise ValueError(f"there is no camera {which!r:.60}; {there}")
        one = self._cameras[which]
        if isinstance(one, Camera):
            self._camera, self._camera_track = one, None
        else:
            self._camera, self._camera_track = one.still, one

    @property
    def camera_track(self) -> CameraMotion | None:
        """How the camera moves, or None where it does not; setting a `camera` ends it."""
        return self._camera_track

    def camera_at(self, time: float) -> Camera:
        """The camera at a time; see `at` for the rest.

        Parameters
        ----------
        time : float
            In the units of the file's keyframes.

        Returns
        -------
        Camera
            What the track says; without one, `camera`.

        Raises
        ------
        ValueError
            If `time` is not finite.
        """
        if not math.isfinite(time):
            raise ValueError(f"time: expected a finite number, got {time}")
        return self.camera if self._camera_track is None else self._camera_track.at(time)

    @property
    def animation(self) -> Animation | None:
        """How meshes and lights move, or None where they do not."""
        return self._animation

    @animation.setter
    def animation(self, animation: Animation | None) -> None:
        self._animation = animation

    def at(self, time: float) -> Scene:
        """The scene at a time.

        Parameters
        ----------
        time : float
            In the units of the file's keyframes.

        Returns
        -------
        Scene
            Its meshes, lights and camera are those of that time; meshes that do not move are
            the same objects. It can be asked for other times as this one can.

        Raises
        ------
        ValueError
            If `time` is not finite.

        Examples
        --------
        >>> import raystream as rs
        >>> scene = rs.load("robots.aff")  # doctest: +SKIP
        >>> tracer = rs.Tracer(scene)  # doctest: +SKIP
        >>> report = tracer.update(scene.at(5.0))  # doctest: +SKIP
        """
        if not math.isfinite(time):
            raise ValueError(f"time: expected a finite number, got {time}")
        scene = Scene.__new__(Scene)
        scene.__dict__.update(self.__dict__)
        if self._animation is not None:
            posed = self._animation.at(time)
            scene.meshes, scene.materials = posed.meshes, posed.materials
            scene.lights = posed.lights
            is_still = list(map(id, scene.meshes)) == list(map(id, self.meshes))
            scene._triangles = self._triangles if is_still else posed._triangles
        if self._camera_track is not None:
            scene._camera = self._camera_track.at(time)
        return scene

    def timeline(self, fps: float | None = None) -> Timeline:
        """The frames of a scene that moves.

        Parameters
        ----------
        fps : float, optional
            Frames in a unit of time; without it, what the file says, else 24.

        Raises
        ------
        ValueError
            If neither meshes, lights nor the camera move, or `fps` is not above 0.
        """
        if self._animation is not None:
            return self._animation.timeline(fps)
        if self._camera_track is None:
            raise ValueError("scene: nothing moves in it, neither meshes nor the camera")
        return Timeline(*self._camera_track.times, FPS if fps is None else fps)

    @property
    def area_lights(self) -> list[AreaLight]:
        """The emissive triangles, one entry for each mesh and emissive material.

        Materials whose emission is a texture, and those that are not opaque, glow, but do not
        count: such textures are mostly black, and what is cut out sends no light.
        """
        lights = []
        first = 0
        emissive = {
            index: material.emission
            for index, material in enumerate(self.materials)
            if material.emits and material.is_opaque and "emission" not in material.textures
        }
        for mesh_id, mesh in enumerate(self.meshes):
            for material_id, radiance in emissive.items():
                faces = np.flatnonzero(mesh.material_ids == material_id)
                if len(faces):
                    prim_ids = (first + faces).astype(np.int32)
                    lights.append(AreaLight(mesh_id, prim_ids, radiance))
            first += len(mesh.faces)
        return lights

    def __repr__(self) -> str:
        name = f"{self.name!r}, " if self.name else ""
        return f"Scene({name}{len(self.meshes)} meshes, {self.triangle_count:,} triangles)"

    def _repr_html_(self) -> str:
        """Show what is in the scene in a notebook."""
        corners = [" ".join(f"{number:.6g}" for number in corner) for corner in self.bounds]
        kinds = [type(light).__name__.removesuffix("Light").lower() for light in self.lights]
        kinds += ["area"] * len(self.area_lights)
        lights = [f"{kinds.count(kind):,} {kind}" for kind in dict.fromkeys(kinds)]
        rows = [
            ("triangles", f"{self.triangle_count:,}"),
            ("vertices", f"{sum(len(mesh.vertices) for mesh in self.meshes):,}"),
            ("meshes", f"{len(self.meshes):,}"),
            ("materials", f"{len(self.materials):,}"),
            ("lights", ", ".join(lights) or "none"),
            ("low corner", corners[0]),
            ("high corner", corners[1]),
        ]
        return html_table(f"Scene {self.name}".strip(), rows)
