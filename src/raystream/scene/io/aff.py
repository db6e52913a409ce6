"""AFF: BART's animated scenes, and the Neutral File Format that they extend."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError
from raystream.scene.camera import Camera
from raystream.scene.camera_track import CameraTrack
from raystream.scene.io.aff_animation import Keyframes
from raystream.scene.io.aff_shapes import MorphingTriangle, Shape
from raystream.scene.io.aff_statements import (
    AffFiles,
    AffMaterial,
    Begin,
    Detail,
    End,
    Include,
    Lamp,
    Statement,
)
from raystream.scene.io.files import find_sibling
from raystream.scene.io.instances import TriangleBudget, placed
from raystream.scene.io.partial import warn_partial
from raystream.scene.lights import EnvironmentLight, Light, PointLight
from raystream.scene.material import Color, Material
from raystream.scene.mesh import Mesh
from raystream.scene.scene import Scene
from raystream.scene.splines import position_at
from raystream.scene.texture import Texture

__all__ = ["read_aff"]

#: Includes within includes; BART needs 4.
MAX_DEPTH = 32

#: Statements carried out, counting each inclusion of a file; BART needs 10,000.
MAX_STATEMENTS = 1 << 19

_DEFAULT_FOV = 40.0


def read_aff(path: Path, *, time: float = 0.0) -> Scene:
    """Read a scene of BART, or an NFF file, as it is at one time.

    Each mesh, run of polygons, and quadric becomes a mesh in world space, in the order of the
    files, every time that its file is included; spheres and cones are cut into triangles.

    Parameters
    ----------
    path : Path
        The ``.aff`` or ``.nff`` file that includes all others; they lie next to it, and
        textures next to it or in a folder ``TextureFiles`` there or one level up.
    time : float
        In the units of the file's keyframes, usually seconds; beyond the first and the last
        usable key things stand still.

    Returns
    -------
    Scene
        Of a material ``fm``, the specular colour is both the highlight's and the mirror's, as
        in BART; T becomes the same transmission in all colours. Lights do not weaken with
        distance. Ambient light ``am`` becomes an `EnvironmentLight` that adds to the
        scene's triangles, on average, what the ambient term would have added where
        nothing blocks it. The keyframes ``camera`` win over the view block ``v``; the
        camera is the one at `time`, and its track has all times.

    Raises
    ------
    FileFormatError
        If a file is missing, damaged or truncated, or includes itself.

    Warns
    -----
    RaystreamWarning
        For triangles and textures that had to be left out.

    References
    ----------
    Lext, Assarsson and Moeller, "BART: A Benchmark for Animated Ray Tracing", Chalmers
    technical report 00-14, 2000.
    """
    files = AffFiles(path)
    files.read()
    builder = _Builder(files, time)
    builder.include(path, 0)
    files.checks.report()
    if builder.missing:
        listed = ", ".join(sorted(builder.missing)[:5])
        warn_partial(path, f"textures not found: {listed}")
    camera = _camera(files, time)
    return Scene(
        builder.meshes,
        materials=builder.materials,
        lights=builder.all_lights(),
        camera=camera,
        camera_track=None if camera is None else _camera_track(files, camera),
        background=_color(files.background or (0.0, 0.0, 0.0)),
        name=path.name,
    )


class _Builder:
    """Carries out the statements of all files."""

    def __init__(self, files: AffFiles, time: float) -> None:
        self.files = files
        self.time = time
        self.meshes: list[Mesh] = []
        self.materials: list[Material] = []
        self.missing: set[str] = set()
        self._lamps: list[tuple[NDArray[np.float64], Color | None]] = []
        self._material = AffMaterial((0.0,) * 3, (0.8,) * 3, (0.0,) * 3, 0.0, 0.0, 1.0)
        self._ambients: list[tuple[float, ...]] = []
        self._places: dict[tuple[AffMaterial, str], int] = {}
        self._textures: dict[str, Texture | None] = {}
        self._moves: dict[str, tuple[NDArray[np.float64], bool]] = {}
        self._matrices = [np.eye(4)]
        self._hidden = 0
        self._detail = 0
        self._statement_count = 0
        self._budget = TriangleBudget(files.path)

    def include(self, path: Path, depth: int) -> None:
        """Carry out one file; materials and the level of detail outlast it."""
        if depth > MAX_DEPTH:
            raise FileFormatError(
                self.files.path, f"includes itself, or files more than {MAX_DEPTH} deep"
            )
        statements = self.files.statements[path]
        self._statement_count += 1 + len(statements)
        if self._statement_count > MAX_STATEMENTS:
            raise FileFormatError(
                self.files.path, f"its includes add up to more than {MAX_STATEMENTS:,} statements"
            )
        opened: list[bool] = []
        for statement in statements:
            if isinstance(statement, Include):
                if statement.level <= self._detail:
                    self.include(self.files.included(statement.name, path), depth + 1)
            elif isinstance(statement, Begin):
                opened.append(self._begin(statement))
            elif isinstance(statement, End):
                self._matrices.pop()
                self._hidden -= opened.pop()
            else:
                self._carry_out(statement, path)

    def _begin(self, begin: Begin) -> bool:
        """Open a transform; True when it hides what it holds."""
        if begin.matrix is not None:
            matrix, visible = begin.matrix, True
        else:
            matrix, visible = self._animated(begin.name)
        with np.errstate(all="ignore"):
            self._matrices.append(self._matrices[-1] @ matrix)
        self._hidden += not visible
        return not visible

    def _animated(self, name: str) -> tuple[NDArray[np.float64], bool]:
        """Evaluate keyframes, once for each name; without any nothing moves."""
        if name not in self._moves:
            keys = self.files.keyframes.get(name, Keyframes())
            self._moves[name] = keys.matrix(self.time), keys.visible(self.time)
        return self._moves[name]

    def _carry_out(self, statement: Statement, path: Path) -> None:
        if isinstance(statement, AffMaterial):
            self._material = statement
        elif isinstance(statement, Detail):
            self._detail = statement.level
        elif isinstance(statement, Shape) and not self._hidden:
            self._add_shape(statement, path.stem)
        elif isinstance(statement, Lamp) and not self._hidden:
            self._add_lamp(statement)

    def _add_shape(self, shape: Shape, name: str) -> None:
        mesh = shape.mesh
        if isinstance(mesh, MorphingTriangle):
            mesh = mesh.mesh(self.time)
        if mesh.triangle_count == 0:
            return
        self._budget.spend(mesh)
        placed_mesh = placed(mesh, self._matrices[-1], self._material_id(shape.texture))
        placed_mesh.name = name
        self.meshes.append(placed_mesh)

    def _material_id(self, texture_name: str) -> int:
        key = (self._material, texture_name)
        if key not in self._places:
            self._places[key] = len(self.materials)
            material = _material(self._material)
            texture = self._texture(texture_name) if texture_name else None
            if texture is not None:
                textures = {"diffuse": texture}
                material = replace(material, textures=textures)
            self.materials.append(material)
            self._ambients.append(self._material.ambient)
        return self._places[key]

    def _texture(self, name: str) -> Texture | None:
        if name not in self._textures:
            folder = self.files.path.resolve().parent
            folders = [folder, folder / "TextureFiles", folder.parent / "TextureFiles"]
            hits = [find_sibling(place / self.files.path.name, name) for place in folders]
            found = next((hit for hit in hits if hit is not None), None)
            if found is None:
                self.missing.add(repr(name[:60]))
            self._textures[name] = Texture(found) if found else None
        return self._textures[name]

    def _add_lamp(self, lamp: Lamp) -> None:
        matrix = self._matrices[-1]
        if lamp.name in self.files.keyframes:
            matrix = matrix @ self._animated(lamp.name)[0]
        with np.errstate(all="ignore"):
            position = matrix[:3, :3] @ lamp.position + matrix[:3, 3]
        if np.isfinite(position).all():
            self._lamps.append((position, None if lamp.color is None else _color(lamp.color)))

    def all_lights(self) -> list[Light]:
        """Make the lights; NFF's lights without a colour share the brightness of one."""
        share = 1.0 / math.sqrt(len(self._lamps)) if self._lamps else 1.0
        lights: list[Light] = [
            PointLight((x, y, z), color or (share, share, share), falloff="none")
            for (x, y, z), color in self._lamps
        ]
        ambient = self._environment()
        return [*lights, ambient] if ambient is not None else lights

    def _environment(self) -> EnvironmentLight | None:
        """Spread ambient light over the sky: am x mean ambient / mean diffuse."""
        if self.files.ambient is None or not self.meshes:
            return None
        counts = np.zeros(len(self.materials))
        for mesh in self.meshes:
            counts[mesh.material_ids[0]] += mesh.triangle_count
        diffuse = np.array([material.diffuse for material in self.materials])
        mean_ambient = float(counts @ np.array([_color(a) for a in self._ambients]).mean(axis=1))
        mean_diffuse = float(counts @ diffuse.mean(axis=1))
        if not (mean_ambient > 0.0 and mean_diffuse > 0.0):
            return None
        strength = mean_ambient / mean_diffuse
        radiance = tuple(min(strength * c, 1e30) for c in _color(self.files.ambient))
        return EnvironmentLight(radiance) if any(radiance) else None  # type: ignore[arg-type]


def _material(source: AffMaterial) -> Material:
    specular = _color(source.specular)
    through = _color((source.transmittance,) * 3)
    return Material(
        diffuse=_color(source.diffuse),
        specular=specular,
        shininess=_color((source.shininess,) * 3)[0],
        reflection=specular,
        transmission=through,
        ior=source.ior if math.isfinite(source.ior) and source.ior > 0.0 else 1.0,
    )


def _color(values: tuple[float, ...]) -> Color:
    """Make a colour of any three numbers: what is negative or not finite becomes 0."""
    red, green, blue = (v if math.isfinite(v) and v > 0.0 else 0.0 for v in values)
    return red, green, blue


def _camera(files: AffFiles, time: float) -> Camera | None:
    """Take the view from the keyframes ``camera``, and what they lack from the block ``v``."""
    view = files.view
    fov = view.get("angle", [_DEFAULT_FOV])[0]
    keys = files.keyframes.get("camera", Keyframes())
    eye = np.array(view["from"]) if "from" in view else None
    toward = np.array(view["at"]) - eye if eye is not None and "at" in view else None
    up = np.array(view.get("up", (0.0, 1.0, 0.0)))
    with np.errstate(all="ignore"):
        if keys.translation is not None:
            eye = position_at(keys.translation, time)
        if keys.rotation is not None:
            turn = Keyframes(rotation=keys.rotation).matrix(time)
            toward, up = -turn[:3, 2], turn[:3, 1]
        if eye is None or toward is None:
            return None
        look_at = eye + toward / np.linalg.norm(toward)
    try:
        with np.errstate(all="ignore"):
            return Camera(tuple(eye), tuple(look_at), tuple(up), fov)
    except ValueError as error:
        raise FileFormatError(files.path, f"its view makes no sense ({error})") from None


def _camera_track(files: AffFiles, camera: Camera) -> CameraTrack | None:
    """Take the keyframes ``camera``; what they lack stays as it is in a camera of any time."""
    keys = files.keyframes.get("camera", Keyframes())
    if keys.translation is None and keys.rotation is None:
        return None
    try:
        return CameraTrack(camera, keys.translation, keys.rotation)
    except ValueError as error:
        raise FileFormatError(files.path, f"its camera's keys make no sense ({error})") from None
