"""AFF builder: executes the statements of a scene, at any time."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError
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
from raystream.scene.io.instances import Placements, TriangleBudget
from raystream.scene.lights import EnvironmentLight, Light, PointLight
from raystream.scene.material import Color, Material
from raystream.scene.mesh import Mesh
from raystream.scene.texture import Texture

#: Maximum depth of includes; BART needs 4.
MAX_DEPTH = 32

_NONE: Color = (0.0, 0.0, 0.0)

#: Maximum statements executed, counting each inclusion of a file; BART needs 10,000.
MAX_STATEMENTS = 1 << 19


class AffBuilder:
    """Executes the statements of all files, for one time after the other.

    Materials, textures, and static meshes are the same objects each time.

    Parameters
    ----------
    files : AffFiles

    Attributes
    ----------
    meshes : list of Mesh
    materials : list of Material
    missing : set of str
        Textures that were not found.
    """

    def __init__(self, files: AffFiles) -> None:
        self.files = files
        self.materials: list[Material] = []
        self.missing: set[str] = set()
        self._ambients: list[tuple[float, ...]] = []
        self._places: dict[tuple[AffMaterial, str], int] = {}
        self._textures: dict[str, Texture | None] = {}
        self._placements = Placements()

    def build(self, time: float) -> None:
        """Execute all statements."""
        self.time = time
        self.meshes: list[Mesh] = []
        self._lamps: list[tuple[NDArray[np.float64], Color | None]] = []
        self._material = AffMaterial((0.0,) * 3, (0.8,) * 3, (0.0,) * 3, 0.0, 0.0, 1.0)
        self._moves: dict[str, tuple[NDArray[np.float64], bool]] = {}
        self._matrices = [np.eye(4)]
        self._hidden = 0
        self._detail = 0
        self._statement_count = 0
        self._budget = TriangleBudget(self.files.path)
        self._placements.begin()
        self.include(self.files.path, 0)

    def include(self, path: Path, depth: int) -> None:
        """Execute one file; materials and the level of detail stay in effect after it."""
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
                self._execute(statement, path)

    def _begin(self, begin: Begin) -> bool:
        """Push a transform; return whether its contents are invisible."""
        if begin.matrix is not None:
            matrix, visible = begin.matrix, True
        else:
            matrix, visible = self._animated(begin.name)
        with np.errstate(all="ignore"):
            self._matrices.append(self._matrices[-1] @ matrix)
        self._hidden += not visible
        return not visible

    def _animated(self, name: str) -> tuple[NDArray[np.float64], bool]:
        """Evaluate keyframes, once per name; identity and visible without any."""
        if name not in self._moves:
            keys = self.files.keyframes.get(name, Keyframes())
            self._moves[name] = keys.matrix(self.time), keys.visible(self.time)
        return self._moves[name]

    def _execute(self, statement: Statement, path: Path) -> None:
        if isinstance(statement, AffMaterial):
            self._material = statement
        elif isinstance(statement, Detail):
            self._detail = statement.level
        elif isinstance(statement, Shape):
            if self._hidden:
                self._placements.skip()
            else:
                self._add_shape(statement, path.stem)
        elif isinstance(statement, Lamp) and not self._hidden:
            self._add_lamp(statement)

    def _add_shape(self, shape: Shape, name: str) -> None:
        mesh = shape.mesh
        if isinstance(mesh, MorphingTriangle):
            mesh = mesh.mesh(self.time)
        if mesh.triangle_count == 0:
            self._placements.skip()
            return
        self._budget.spend(mesh)
        material = self._material_id(shape.texture)
        self.meshes.append(self._placements.place(mesh, self._matrices[-1], material, name))

    def _material_id(self, texture_name: str) -> int:
        key = (self._material, texture_name)
        if key not in self._places:
            self._places[key] = len(self.materials)
            material = _material(self._material, self.files.ambient or _NONE)
            texture = self._texture(texture_name) if texture_name else None
            if texture is not None:
                role = "emission" if material.emits else "diffuse"
                material = replace(material, textures={role: texture})
            self.materials.append(material)
            self._ambients.append(_NONE if material.emits else self._material.ambient)
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
            self._lamps.append((position, None if lamp.color is None else color(lamp.color)))

    def all_lights(self) -> list[Light]:
        """Make the lights; NFF lights without a colour share the brightness of one."""
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
        mean_ambient = float(counts @ np.array([color(a) for a in self._ambients]).mean(axis=1))
        mean_diffuse = float(counts @ diffuse.mean(axis=1))
        if not (mean_ambient > 0.0 and mean_diffuse > 0.0):
            return None
        strength = mean_ambient / mean_diffuse
        radiance = tuple(min(strength * c, 1e30) for c in color(self.files.ambient))
        return EnvironmentLight(radiance) if any(radiance) else None  # type: ignore[arg-type]


def _material(source: AffMaterial, ambient: tuple[float, ...]) -> Material:
    """Make a material; one with an ambient colour only, such as a backdrop, emits light."""
    diffuse, specular = color(source.diffuse), color(source.specular)
    through = color((source.transmittance,) * 3)
    glow = _NONE
    if not any((*diffuse, *specular, *through)):
        shares = zip(color(source.ambient), color(ambient), strict=True)
        glow = color(tuple(min(a * b, 1e30) for a, b in shares))
    return Material(
        diffuse=diffuse,
        specular=specular,
        shininess=color((source.shininess,) * 3)[0],
        reflection=specular,
        transmission=through,
        ior=source.ior if math.isfinite(source.ior) and source.ior > 0.0 else 1.0,
        emission=glow,
    )


def color(values: tuple[float, ...]) -> Color:
    """Make a colour from three numbers: negative and non-finite ones become 0."""
    red, green, blue = (v if math.isfinite(v) and v > 0.0 else 0.0 for v in values)
    return red, green, blue
