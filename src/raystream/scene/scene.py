"""Scene: meshes with materials, lights and a camera."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raystream.core.triangles import Triangles
from raystream.scene.camera import Camera, unit_vector
from raystream.scene.camera_track import CameraTrack
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
        camera_track: CameraTrack | None = None,
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
    def camera_track(self) -> CameraTrack | None:
        """How the camera moves, or None where it does not; setting a `camera` ends it."""
        return self._camera_track

    def camera_at(self, time: float) -> Camera:
        """The camera at a time; meshes and lights stay as they were loaded.

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
    def area_lights(self) -> list[AreaLight]:
        """The emissive triangles, one entry for each mesh and emissive material.

        Materials whose emission is a texture glow, but do not count: such textures are
        mostly black.
        """
        lights = []
        first = 0
        emissive = {
            index: material.emission
            for index, material in enumerate(self.materials)
            if material.emits and "emission" not in material.textures
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
