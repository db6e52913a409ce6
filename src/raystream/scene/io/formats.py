"""Formats: choice of the reader for a file, and checks common to all formats."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from raystream.core.errors import FileFormatError, RaystreamError
from raystream.scene.io.files import model_suffix
from raystream.scene.io.partial import check_loaded
from raystream.scene.scene import Scene

#: Module and function that read each format; modules are imported on first use.
_READERS = {
    ".obj": ("obj", "read_obj"),
    ".ply": ("ply", "read_ply"),
    ".stl": ("stl", "read_stl"),
    ".off": ("off", "read_off"),
    ".gltf": ("gltf", "read_gltf"),
    ".glb": ("gltf", "read_gltf"),
    ".aff": ("aff", "read_aff"),
    ".nff": ("aff", "read_aff"),
}

#: Formats whose readers take a time, those with instances, and all formats that may be animated.
TIMED = frozenset({".aff", ".nff"})
INSTANCED = frozenset({".gltf", ".glb"})
ANIMATED = TIMED | INSTANCED

#: The file extensions of all formats; each may be followed by ``.gz``.
SUFFIXES = tuple(_READERS)


def read_model(path: Path, *, time: float = 0.0, has_instances: bool = False) -> Scene:
    """Read a model file of any format.

    Parameters
    ----------
    path : Path
        The file extension selects the format; a ``.gz`` after it is unpacked.
    time : float
        For animated formats: the time to show, in the file's units. At 0, glTF is at rest.
    has_instances : bool
        For glTF: make a scene of instances, see `read_gltf`.

    Returns
    -------
    Scene
        Possibly without triangles.

    Raises
    ------
    FileFormatError
        For any problem with the file: a message of one line that names it.
    ValueError
        If `time` is given for a format without animation, or a glTF file without one.

    Warns
    -----
    RaystreamWarning
        For parts of the file that could not be used, and for a file without triangles.
    """
    suffix = model_suffix(path)
    if suffix not in _READERS:
        known = " ".join(SUFFIXES)
        raise FileFormatError(path, f"unsupported file extension; supported: {known}")
    if suffix not in ANIMATED and time != 0.0:
        raise ValueError(
            f"time: {suffix} files are not animated, only {' '.join(sorted(ANIMATED))}"
        )
    if has_instances and suffix not in INSTANCED:
        raise ValueError(
            f"instances: not supported for {suffix} files, only {' '.join(sorted(INSTANCED))}"
        )
    try:
        scene = check_loaded(path, _reader(suffix, time, has_instances)(path))
    except (RaystreamError, Warning):  # warnings are errors when the user makes them so
        raise
    except MemoryError:
        raise FileFormatError(path, "is too large for this machine's memory") from None
    except Exception as error:  # hostile files may cause errors that readers do not expect
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise FileFormatError(path, f"cannot be read as {suffix} ({reason[:200]})") from error
    if time == 0.0 or suffix in TIMED or has_instances:
        return scene
    if scene.animation is None:
        raise ValueError(f"time: {path} is not animated")
    return scene.at(time)


def _reader(suffix: str, time: float, has_instances: bool) -> Callable[[Path], Scene]:
    module, name = _READERS[suffix]
    function: Callable[..., Scene] = getattr(import_module(f"raystream.scene.io.{module}"), name)
    if has_instances:
        pose = time if time != 0.0 else None
        return lambda path: function(path, time=pose, has_instances=True)
    if suffix in TIMED:
        return lambda path: function(path, time=time)
    return function
