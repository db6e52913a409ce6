"""AFF statements: the parsed files of a BART scene."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError
from raystream.scene.io.aff_animation import Keyframes, read_keyframes, static_matrix
from raystream.scene.io.aff_shapes import Shape, merged, read_shape
from raystream.scene.io.aff_words import Words
from raystream.scene.io.files import find_sibling
from raystream.scene.io.partial import IndexCheck
from raystream.scene.io.text import shown

#: A scene with more files than this is assumed to be hostile; BART's kitchen has 53.
MAX_FILES = 4096

#: Shapes of a few triangles each; consecutive ones are merged.
POLYGONS = frozenset({b"p", b"pp", b"tt", b"ttt", b"ttp"})


@dataclass(frozen=True)
class Begin:
    """Begin of a transform: a fixed matrix, or the name of an animated one."""

    matrix: NDArray[np.float64] | None = None
    name: str = ""


@dataclass(frozen=True)
class End:
    """End of the innermost transform."""


@dataclass(frozen=True)
class Include:
    """Inclusion of another file, if its level is not above the level of detail."""

    name: str
    level: int


@dataclass(frozen=True)
class Detail:
    """The level of detail of the following statements."""

    level: int


@dataclass(frozen=True)
class AffMaterial:
    """The material of the following shapes: ``fm``, or ``f`` converted to it."""

    ambient: tuple[float, ...]
    diffuse: tuple[float, ...]
    specular: tuple[float, ...]
    shininess: float
    transmittance: float
    ior: float


@dataclass(frozen=True)
class Lamp:
    """A point light; an animated one has a name."""

    position: NDArray[np.float64]
    color: tuple[float, ...] | None
    name: str = ""


Statement = Begin | End | Include | Detail | AffMaterial | Lamp | Shape


@dataclass
class AffFiles:
    """All files of a scene, each parsed once.

    Parameters
    ----------
    path : Path
        The main file.

    Attributes
    ----------
    statements : dict of Path to list
        The statements of each file, in order; filled by `read`.
    keyframes : dict of str to Keyframes
        By name; they may come after the statements that use them.
    view : dict of str to list of float
        ``from``, ``at``, ``up``, ``angle``.
    timing : (float, float, float) or None
        First and last time, and number of frames.
    background, ambient : tuple of float or None
    """

    path: Path
    statements: dict[Path, list[Statement]] = field(default_factory=dict)
    keyframes: dict[str, Keyframes] = field(default_factory=dict)
    view: dict[str, list[float]] = field(default_factory=dict)
    timing: tuple[float, float, float] | None = None
    background: tuple[float, ...] | None = None
    ambient: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        self.checks = IndexCheck(self.path)
        self._found: dict[tuple[str, Path], Path] = {}

    def read(self) -> None:
        """Read the main file and all that it includes."""
        waiting = [self.path]
        while waiting:
            path = waiting.pop()
            if path in self.statements:
                continue
            if len(self.statements) >= MAX_FILES:
                raise FileFormatError(self.path, f"includes more than {MAX_FILES:,} files")
            self.statements[path] = found = self._file(Words(path))
            waiting += [self.included(s.name, path) for s in found if isinstance(s, Include)]

    def included(self, name: str, within: Path) -> Path:
        """Find an included file, next to the main one, else next to the one that includes it."""
        key = name, within.parent
        if key not in self._found:
            path = find_sibling(self.path, name) or find_sibling(within, name)
            if path is None:
                raise FileFormatError(
                    self.path, f"includes {shown(name.encode())}, which is not next to it"
                )
            self._found[key] = path
        return self._found[key]

    def _file(self, words: Words) -> list[Statement]:
        found: list[Statement] = []
        polygons: list[Shape] = []
        depth = 0
        while not words.done():
            keyword = words.word()
            if keyword in POLYGONS:
                shape = read_shape(keyword, words, self.checks)
                polygons += [shape] if shape is not None else []
                continue
            found += merged(polygons)
            polygons.clear()
            if keyword in (b"x", b"xs"):
                depth += 1
                found.append(_begin(keyword, words))
            elif keyword == b"}":
                depth -= 1
                if depth < 0:
                    raise words.error("closes a '}' that was never opened")
                found.append(End())
            elif not self._setting(keyword, words):
                found.append(self._content(keyword, words))
        found += merged(polygons)
        if depth:
            raise words.error(f"is truncated: {depth} '{{' are never closed")
        return found

    def _setting(self, keyword: bytes, words: Words) -> bool:
        """Read a statement that applies to the whole scene; return whether it is one."""
        if keyword == b"v":
            self._view(words)
        elif keyword == b"b":
            self.background = tuple(words.floats(3).tolist())
        elif keyword == b"am":
            self.ambient = tuple(words.floats(3).tolist())
        elif keyword == b"a":
            self._timing(words)
        elif keyword == b"k":
            name = words.name()
            self.keyframes[name] = read_keyframes(words)
        else:
            return False
        return True

    def _timing(self, words: Words) -> None:
        """Read first and last time, and number of frames; invalid ones are ignored."""
        first, last, count = words.floats(3).tolist()
        if -math.inf < first < last < math.inf and 1.0 <= count < math.inf:
            self.timing = first, last, count

    def _view(self, words: Words) -> None:
        widths = {b"from": 3, b"at": 3, b"up": 3, b"angle": 1, b"hither": 1, b"resolution": 2}
        while words.peek() in widths:
            key = words.word()
            self.view[key.decode()] = words.floats(widths[key]).tolist()

    def _content(self, keyword: bytes, words: Words) -> Statement:
        """Read a statement whose position in the scene matters."""
        if keyword == b"i":
            return Include(level=int(words.integers(1)[0]), name=words.name())
        if keyword == b"d":
            return Detail(int(words.integers(1)[0]))
        if keyword == b"fm":
            numbers = words.floats(12).tolist()
            return AffMaterial(
                tuple(numbers[:3]), tuple(numbers[3:6]), tuple(numbers[6:9]), *numbers[9:]
            )
        if keyword == b"f":
            return _plain_material(words)
        if keyword in (b"l", b"la"):
            return _lamp(words)
        shape = read_shape(keyword, words, self.checks)
        if shape is None:
            raise words.error(f"unknown statement {shown(keyword)}")
        return shape


def _begin(keyword: bytes, words: Words) -> Begin:
    if keyword == b"x":
        begin = Begin(name=words.name())
    else:
        begin = Begin(matrix=static_matrix(words.floats(10)))
    words.expect(b"{")
    return begin


def _plain_material(words: Words) -> AffMaterial:
    """Read NFF's ``f``: a colour, its diffuse and specular coefficients, and the rest."""
    red, green, blue, diffuse, specular, shininess, transmittance, ior = words.floats(8).tolist()
    color = (red, green, blue)
    return AffMaterial(
        (0.0, 0.0, 0.0),
        tuple(diffuse * c for c in color),
        (specular, specular, specular),
        shininess,
        transmittance,
        ior,
    )


def _lamp(words: Words) -> Lamp:
    name = "" if words.number_follows() else words.name()
    position = words.floats(3)
    color = tuple(words.floats(3).tolist()) if words.number_follows() else None
    return Lamp(position, color, name)
