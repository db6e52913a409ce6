"""Scene: meshes with materials, lights and a camera."""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raystream.core.attributes import Attributes
from raystream.core.checks import check_finite
from raystream.core.triangles import Triangles
from raystream.notebook import html_table
from raystream.scene.animation import FPS, Animation, Timeline
from raystream.scene.camera import Camera, unit_vector
from raystream.scene.camera_track import CameraMotion
from raystream.scene.geometry import Geometry
from raystream.scene.lights import AreaLight, Light
from raystream.scene.material import Color, Material
from raystream.scene.mesh import Mesh
from raystream.scene.primitive_scene import PrimitiveScene
from raystream.scene.store_geometry import geometry_of_store
from raystream.scene.views import Views

#: Parts of a scene that an animation sets.
_ANIMATED = ("meshes", "materials", "lights")


class _Parts(TypedDict, total=False):
    """Arguments of `Scene.replace`: the parameters of `Scene`."""

    meshes: Sequence[Mesh]
    materials: Sequence[Material]
    lights: Sequence[Light]
    camera: Camera | str | int | None
    camera_track: CameraMotion | None
    cameras: Mapping[str, Camera | CameraMotion]
    animation: Animation | None
    up: ArrayLike
    background: Color
    name: str


class Scene(PrimitiveScene):
    """Geometry to trace rays against, with materials, lights and cameras to render it.

    A scene is immutable: `replace` makes another one, which shares unchanged parts.

    Parameters
    ----------
    meshes : sequence of Mesh
        Their triangles are numbered one mesh after another: `prim_id` counts over all meshes.
    materials : sequence of Material, optional
        Indexed by each mesh's ``material_ids`` [default: one grey material].
    lights : sequence of PointLight, SpotLight, DirectionalLight or EnvironmentLight, optional
        Area lights are not listed: they follow from emissive materials.
    camera : Camera, str or int, optional
        The default view, or the name or number of one of `cameras`
        [default: `camera_track` at rest, else the first of `cameras`, else one chosen by
        `camera_for`].
    camera_track : CameraTrack, optional
        Motion of the camera; see `camera_at`.
    cameras : mapping of str to Camera or CameraTrack, optional
        Views to choose from, by name.
    animation : Animation, optional
        Motion of meshes and lights; see `at`.
    up : array_like of shape (3,), optional
        The world's up direction, used to frame the scene.
    background : Color, optional
        Radiance along rays that miss, linear RGB.
    name : str, optional
        Label; need not be unique.

    Raises
    ------
    ValueError
        If a mesh refers to a material that does not exist, `cameras` has no such camera, or `up`
        is zero.
    """

    def __init__(
        self,
        meshes: Sequence[Mesh] = (),
        *,
        materials: Sequence[Material] = (),
        lights: Sequence[Light] = (),
        camera: Camera | str | int | None = None,
        camera_track: CameraMotion | None = None,
        cameras: Mapping[str, Camera | CameraMotion] | None = None,
        animation: Animation | None = None,
        up: ArrayLike = (0.0, 1.0, 0.0),
        background: Color = (0.0, 0.0, 0.0),
        name: str = "",
    ) -> None:
        self._geometry = Geometry(meshes)
        self._materials = tuple(materials) or (Material(),)
        self._lights = tuple(lights)
        self._name = str(name)
        self._up = unit_vector("up", up)
        self._up.flags.writeable = False
        self._background = background
        self._views = Views.of(camera, camera_track, cameras)
        self._animation = animation
        for index, mesh in enumerate(self.meshes):
            if len(mesh.faces) and int(mesh.material_ids.max()) >= len(self.materials):
                raise ValueError(
                    f"mesh {index} ({mesh.name!r}) uses material {int(mesh.material_ids.max())}, "
                    f"but the scene has {len(self.materials)}"
                )

    def __setattr__(self, name: str, value: Any) -> None:
        if not name.startswith("_"):
            is_part = name in _Parts.__annotations__
            how = f"; scene.replace({name}=...) makes another" if is_part else ""
            raise AttributeError(f"{name}: scenes are immutable{how}")
        super().__setattr__(name, value)

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
            ``normals``, ``colors``, ``texcoords``, ``material_ids``, ``face_ids``, ``name``,
            ``mask``: see `Mesh`.

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
        """Make a scene from a triangle store: the same triangles, meshes and masks, no more."""
        geometry = geometry_of_store(triangles)
        count = int(geometry.material_ids.max(initial=0)) + 1
        return cls(materials=[Material()] * count)._with(_geometry=geometry)

    def replace(self, **changes: Unpack[_Parts]) -> Scene:
        """Copy the scene with some parts replaced; unchanged parts are shared.

        Parameters
        ----------
        **changes
            Parameters of `Scene`. A `camera` removes the current camera track.

        Returns
        -------
        Scene
            If the meshes are unchanged, so are the triangles, and `Tracer.update` accepts it
            without rebuilding anything.

        Raises
        ------
        ValueError, TypeError
            As `Scene`.

        Notes
        -----
        Replaced meshes, materials and lights are static; the others follow the animation.

        Examples
        --------
        >>> import raystream as rs
        >>> scene = rs.load("cornell")
        >>> sunny = scene.replace(lights=[rs.DirectionalLight((0, -1, 1), (3, 3, 3))])
        >>> len(scene.lights), len(sunny.lights), sunny.triangles is scene.triangles
        (0, 1, True)
        """
        views, animation = self._views, self._animation
        given: dict[str, Any] = dict(changes)
        held = {name: given[name] for name in _ANIMATED if name in given}
        if animation is not None and held:
            pose = animation.at
            animation = replace(animation, at=lambda time: pose(time).replace(**held))
        parts: dict[str, Any] = {
            "meshes": self.meshes,
            "materials": self.materials,
            "lights": self.lights,
            "camera": None if given.get("camera_track") else views.camera,
            "camera_track": None if "camera" in given else views.track,
            "cameras": views.named,
            "animation": animation,
            "up": self.up,
            "background": self.background,
            "name": self.name,
        }
        scene = Scene(**(parts | given))
        if "up" not in given:
            scene._up = self._up  # a unit vector that is normalised again may lose a bit
        if _are_same(scene.meshes, self.meshes):
            scene._geometry = self._geometry
        elif self.placements is not None:
            raise ValueError("meshes: fixed in a scene with instances; see Scene.instances")
        elif self.has_primitives:
            raise ValueError("meshes: all other geometry would be lost; see Scene.combine")
        return scene

    def moved(self, meshes: Sequence[Mesh], triangles: Triangles | None) -> Scene:
        """Copy the scene with moved meshes.

        Parameters
        ----------
        meshes : sequence of Mesh
            The same number of meshes, with the same faces.
        triangles : Triangles, optional
            Their triangles [default: made when they are needed].
        """
        return self.with_geometry(Geometry(meshes, triangles))

    def with_geometry(self, geometry: Geometry) -> Scene:
        """Copy the scene with other geometry, of the same materials."""
        return self._with(_geometry=geometry)

    @property
    def meshes(self) -> tuple[Mesh, ...]:
        """The meshes, in the order in which their triangles are numbered."""
        return self._geometry.meshes

    @property
    def materials(self) -> tuple[Material, ...]:
        """The materials, at least one."""
        return self._materials

    @property
    def lights(self) -> tuple[Light, ...]:
        """The lights, without area lights."""
        return self._lights

    @property
    def up(self) -> NDArray[np.float64]:
        """The world's up direction: a unit vector of shape (3,), float64, read-only."""
        return self._up

    @property
    def background(self) -> Color:
        """Radiance along rays that miss, linear RGB."""
        return self._background

    @property
    def name(self) -> str:
        """Label of the scene."""
        return self._name

    @property
    def triangles(self) -> Triangles:
        """The triangles of all meshes, in the form that structures are built from; cached."""
        return self._geometry.triangles

    @property
    def attributes(self) -> Attributes:
        """Attributes of triangles and vertices, one mesh after another."""
        return self._geometry.attributes

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
        """Bounding box of all triangles that can be hit.

        Returns
        -------
        ndarray of shape (2, 3), float64
            Rows: low and high corner, world space; both zero if nothing can be hit. With
            instances, it encloses the bounding boxes of their objects.
        """
        return self.triangles.world_bounds

    @property
    def camera(self) -> Camera:
        """The scene's own camera, or one chosen for 4:3 images; see `camera_for`."""
        return self.camera_for(4.0 / 3.0)

    @property
    def has_lights(self) -> bool:
        """Whether the scene has lights, or surfaces that emit light."""
        glows = self.has_primitives and any(one.emits for one in self.materials)
        return bool(self.lights) or bool(self.area_lights) or glows

    @property
    def has_own_camera(self) -> bool:
        """Whether the scene has a camera, rather than one chosen by `camera_for`."""
        return self._views.camera is not None

    def camera_for(self, aspect: float) -> Camera:
        """The scene's own camera, or one chosen for an aspect ratio.

        Parameters
        ----------
        aspect : float
            Width of the image divided by its height.

        Returns
        -------
        Camera
            If the scene has no camera: one that frames the bulk of the triangles, without distant
            outliers and without the outer parts of a ground that is much larger than the objects
            on it. It looks from the front, right and above, unless more of the scene is visible
            from another direction. If the scene is a room that is best seen from inside, the
            camera is inside it, for any aspect.

        Notes
        -----
        The choice depends only on the triangles and `up`, not on the triangles' order, the
        structure or the device, and is made once.
        """
        if self._views.camera is not None:
            return self._views.camera
        return self._geometry.default_view(self.up).camera(aspect)

    @property
    def cameras(self) -> dict[str, Camera]:
        """The views to choose from, by name, at rest."""
        return {
            name: one if isinstance(one, Camera) else one.still
            for name, one in self._views.named.items()
        }

    @property
    def camera_track(self) -> CameraMotion | None:
        """Motion of the camera, or None if it is static."""
        return self._views.track

    def camera_at(self, time: float) -> Camera:
        """The camera at a time; see `at` for meshes and lights.

        Parameters
        ----------
        time : float
            In the units of the file's keyframes.

        Returns
        -------
        Camera
            The track's camera; without a track, `camera`.

        Raises
        ------
        ValueError
            If `time` is not finite.
        """
        check_finite("time", time)
        track = self.camera_track
        return self.camera if track is None else track.at(time)

    @property
    def animation(self) -> Animation | None:
        """Motion of meshes and lights, or None if they are static."""
        return self._animation

    def at(self, time: float) -> Scene:
        """The scene at a time.

        Parameters
        ----------
        time : float
            In the units of the file's keyframes.

        Returns
        -------
        Scene
            With the meshes, lights and camera of that time; static meshes are shared. It keeps
            the animation, so its own `at` works as well.

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
        check_finite("time", time)
        scene = self._with(_views=self._views.at(time))
        if self._animation is not None:
            posed = self._animation.at(time)
            scene._materials, scene._lights = posed.materials, posed.lights
            is_same = _are_same(posed.meshes, self.meshes)
            if not is_same or posed.placements is not self.placements:
                scene._geometry = posed._geometry
        return scene

    def timeline(self, fps: float | None = None) -> Timeline:
        """The frames of an animated scene.

        Parameters
        ----------
        fps : float, optional
            Frames per unit of time [default: from the file, else 24].

        Raises
        ------
        ValueError
            If meshes, lights and camera are all static, or `fps` is not above 0.
        """
        if self._animation is not None:
            return self._animation.timeline(fps)
        if self.camera_track is None:
            raise ValueError("scene: is static; it animates neither meshes nor the camera")
        return Timeline(*self.camera_track.times, FPS if fps is None else fps)

    @property
    def is_opaque(self) -> bool:
        """Whether every ray that reaches a surface hits it: no material or vertex is faint."""
        return not self.attributes.faint_materials and all(m.is_opaque for m in self.materials)

    @property
    def area_lights(self) -> list[AreaLight]:
        """The emissive triangles, one entry per mesh and emissive material.

        Excludes materials whose emission is a texture, and those that are not opaque: they
        glow, but are not sampled as lights, since such textures are mostly black and cut-outs
        emit nothing. The same holds for materials of spheres and height fields. With instances,
        triangles are listed once, but emit light in each instance.
        """
        lights: list[AreaLight] = []
        others = {*self.primitive_materials, *self.attributes.faint_materials}
        first = 0
        emissive = {
            index: material.emission
            for index, material in enumerate(self.materials)
            if material.emits
            and material.is_opaque
            and "emission" not in material.textures
            and index not in others
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
        placed = "" if self.placements is None else f", {len(self.placements):,} instances"
        counts = f"{len(self.meshes)} meshes, {self.triangle_count:,} triangles"
        return f"Scene({name}{counts}{placed}{self.primitive_counts})"

    def _repr_html_(self) -> str:
        """Show the contents of the scene in a notebook."""
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


def _are_same(meshes: Sequence[Mesh], others: Sequence[Mesh]) -> bool:
    """Whether two sequences hold the same objects."""
    return len(meshes) == len(others) and all(map(operator.is_, meshes, others))
