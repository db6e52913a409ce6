"""load: a scene from a file, a built-in scene or a sample, by name."""

from __future__ import annotations

import os
from difflib import get_close_matches
from os import PathLike, fspath
from pathlib import Path

from raystream.core.checks import check_finite
from raystream.core.errors import FileFormatError
from raystream.scene.io.files import FOLDER
from raystream.scene.io.formats import SUFFIXES, read_model
from raystream.scene.scene import Scene


def load(
    source: str | PathLike[str],
    *,
    time: float = 0.0,
    triangles: int | None = None,
    instances: bool = False,
) -> Scene:
    """Load a scene.

    Parameters
    ----------
    source : str or path
        A model file: OBJ, PLY, STL, OFF, glTF, GLB, or BART's AFF and NFF, each optionally
        compressed with gzip. Or the name of a built-in scene, such as ``"cornell"``,
        optionally with a number of triangles, such as ``"forest:1000000"``. Or the name of a
        sample, such as ``"bunny"``. Anything with a file extension or a slash is a file.
    time : float, optional
        For animated scenes (AFF, glTF): the time to show, in the file's units. At 0, glTF
        shows its rest pose; see also `Scene.at`.
    triangles : int, optional
        For built-in scenes: the approximate number of triangles. Above 500 million, they are made
        with instances if the scene has such a form.
    instances : bool
        For glTF files: store a mesh that several nodes use, or that ``EXT_mesh_gpu_instancing``
        copies, once, with instances; see `Scene.instances`. Such a scene is not animated.
        Otherwise, the mesh is copied for each use. For the built-in scenes ``"forest"`` and
        ``"robots"``: store each kind of tree, or each part of a robot, once, which allows up to
        two billion triangles.

    Returns
    -------
    Scene
        Its triangles keep the file's order; polygons are cut into triangles, see `Mesh.face_ids`.

    Raises
    ------
    FileFormatError
        If there is no such file or name, or the file cannot be used. The message is one line.
    ValueError
        If `time`, `triangles` or `instances` does not apply to the source.

    Warns
    -----
    RaystreamWarning
        If only part of the file could be used: triangles without area or with indices out of
        range, polygons that cross themselves, missing textures. Also if it contains no triangles:
        the scene is then empty, and every ray misses.

    Examples
    --------
    >>> import raystream as rs
    >>> scene = rs.load("cornell")  # doctest: +SKIP
    >>> rs.load("kitchen.aff", time=5.0)  # doctest: +SKIP
    """
    check_finite("time", time)
    name = fspath(source)
    if not isinstance(name, str):
        raise TypeError(f"source: expected text or a path, got {type(source).__name__}")
    if not isinstance(source, str) or _names_file(name):
        if triangles is not None:
            raise ValueError("triangles: only for built-in scenes, not for files")
        return _load_file(name, time, instances)
    return _load_name(name, time, triangles, instances)


def _names_file(source: str) -> bool:
    """Whether text has a slash, or a file extension before any colon."""
    bare, colon, _ = source.partition(":")
    if "/" in source or "\\" in source:
        return True
    return bool(Path(bare).suffix) if colon else bool(Path(source).suffix)


def _load_file(name: str, time: float, has_instances: bool) -> Scene:
    path = Path(name).expanduser()
    try:
        missing = not path.exists()
    except (OSError, ValueError):  # a name that is too long, or contains a null byte
        missing = True
    if missing:
        stem = path.name.partition(".")[0]
        hint = f"; did you mean {stem!r}?" if stem in _known_names() else ""
        raise FileFormatError(name, f"there is no such file{hint}")
    if path.is_dir():
        raise FileFormatError(name, FOLDER)
    return read_model(path, time=time, has_instances=has_instances)


def _load_name(source: str, time: float, triangles: int | None, has_instances: bool) -> Scene:
    from raystream.scene import procedural, samples

    name, colon, size = source.partition(":")
    if name in procedural.BUILTIN:
        if time != 0.0:
            raise ValueError(f"time: the built-in scene {name!r} is not animated")
        if colon:
            if triangles is not None:
                raise ValueError("triangles: given twice, in the name and as an argument")
            triangles = _size(source, size)
        if triangles is not None and hasattr(triangles, "__index__"):
            is_large = triangles > procedural.MAX_TRIANGLES
            has_instances |= is_large and procedural.BUILTIN[name].make_instanced is not None
        return procedural.generate(name, triangles, has_instances)
    if source in samples.SAMPLES:
        if has_instances:
            raise ValueError("instances: only for glTF files and built-in scenes, not for samples")
        if triangles is not None:
            raise ValueError("triangles: only for built-in scenes, not for samples")
        scene = read_model(samples.fetch(source), time=time)
        view = samples.camera(source)
        if view is not None and not scene.has_own_camera:
            scene = scene.replace(camera=view)
        return scene
    if os.path.isdir(source):
        raise FileFormatError(source, FOLDER)
    raise FileFormatError(source or "''", _unknown(name))


def _size(source: str, size: str) -> int:
    digits = size.replace("_", "").replace(",", "")
    if not digits.isascii() or not digits.isdigit() or len(digits) > 10 or int(digits) == 0:
        raise FileFormatError(
            source,
            f"expected a number of triangles after the colon, as in 'forest:1000000', got {size!r}",
        )
    return int(digits)


def _known_names() -> tuple[str, ...]:
    from raystream.scene import procedural, samples

    return (*procedural.BUILTIN, *samples.SAMPLES)


def _unknown(name: str) -> str:
    """Suggest names for an unknown one."""
    from raystream.scene import procedural, samples

    close = get_close_matches(name.lower(), _known_names(), n=1)
    hint = f"; did you mean {close[0]!r}?" if close else "."
    return (
        f"is neither a built-in scene nor a sample{hint} Built-in scenes: "
        f"{', '.join(procedural.BUILTIN)}. Samples: {', '.join(samples.SAMPLES)}. "
        f"Files: {' '.join(SUFFIXES)}, also with .gz"
    )
