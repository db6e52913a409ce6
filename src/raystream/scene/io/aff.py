"""AFF: BART's animated scenes, and the Neutral File Format that they extend."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from raystream.core.errors import FileFormatError
from raystream.scene.animation import FPS, Animation
from raystream.scene.camera import Camera
from raystream.scene.camera_track import CameraTrack
from raystream.scene.io.aff_animation import Keyframes
from raystream.scene.io.aff_builder import AffBuilder, color
from raystream.scene.io.aff_shapes import MorphingTriangle, Shape
from raystream.scene.io.aff_statements import AffFiles, Begin, Lamp
from raystream.scene.io.part_names import number_meshes
from raystream.scene.io.partial import warn_partial
from raystream.scene.scene import Scene
from raystream.scene.splines import position_at

_DEFAULT_FOV = 40.0


def read_aff(path: Path, *, time: float = 0.0) -> Scene:
    """Read a BART scene or an NFF file at one time.

    Each mesh, run of polygons, and quadric becomes a mesh in world space, in file order, each
    time that its file is included; spheres and cones are tessellated.

    Parameters
    ----------
    path : Path
        The ``.aff`` or ``.nff`` file that includes all others; they are next to it, and
        textures next to it or in a folder ``TextureFiles`` there or one level up.
    time : float
        In the units of the file's keyframes, usually seconds; outside the first and the last
        usable key the scene is static.

    Returns
    -------
    Scene
        The specular colour of a material ``fm`` is that of both highlights and mirror
        reflections, as in BART; T becomes the same transmission in all colours. Lights have
        no falloff. Ambient light ``am`` becomes an `EnvironmentLight` whose unoccluded
        contribution equals, on average over the triangles, that of the ambient term. A
        material with only an ambient colour emits it: such are backdrops of the outside. The
        keyframes ``camera`` override the view block ``v``; the camera is the one at `time`,
        and its track has all times. If anything moves, the animation has the times and the
        frame rate of the statement ``a``.

    Raises
    ------
    FileFormatError
        If a file is missing, damaged or truncated, or includes itself.

    Warns
    -----
    RaystreamWarning
        For triangles and textures that were skipped.

    References
    ----------
    Lext, Assarsson and Moeller, "BART: A Benchmark for Animated Ray Tracing", Chalmers
    technical report 00-14, 2000.
    """
    files = AffFiles(path)
    files.read()
    builder = AffBuilder(files)
    builder.build(time)
    number_meshes(builder.meshes)
    files.checks.report()
    if builder.missing:
        listed = ", ".join(sorted(builder.missing)[:5])
        warn_partial(path, f"textures not found: {listed}")
    camera = _camera(files, time)
    track = None if camera is None else _camera_track(files, camera)
    return Scene(
        builder.meshes,
        materials=builder.materials,
        lights=builder.all_lights(),
        camera=camera,
        camera_track=track,
        cameras={} if camera is None else {"camera": camera if track is None else track},
        animation=_animation(files, builder, track),
        background=color(files.background or (0.0, 0.0, 0.0)),
        name=path.name,
    )


@dataclass
class _Poses:
    """Builds the scene at any time; unchanged parts are shared."""

    builder: AffBuilder

    def __call__(self, time: float) -> Scene:
        self.builder.build(time)
        return Scene(
            self.builder.meshes,
            materials=self.builder.materials,
            lights=self.builder.all_lights(),
        )


def _animation(files: AffFiles, builder: AffBuilder, track: CameraTrack | None) -> Animation | None:
    """Return the animation, if any: with the times of ``a``, else those of its keys."""
    spans = _spans(files) + ([] if track is None else [track.times])
    if not spans:
        return None
    times = min(first for first, _ in spans), max(last for _, last in spans)
    fps = FPS
    if files.timing is not None:
        times, fps = files.timing[:2], files.timing[2] / (files.timing[1] - files.timing[0])
    try:
        return Animation(_Poses(builder), times, fps)
    except ValueError:  # all keys at one time, or times that are not finite
        return None


def _spans(files: AffFiles) -> list[tuple[float, float]]:
    """Return start and end of each motion in the scene."""
    spans = []
    named: set[str] = set()
    for statement in (one for content in files.statements.values() for one in content):
        if isinstance(statement, Begin | Lamp) and statement.name:
            named.add(statement.name)
        elif isinstance(statement, Shape) and isinstance(statement.mesh, MorphingTriangle):
            times = statement.mesh.times
            spans.append((float(times.min()), float(times.max())))
    for name in named & set(files.keyframes):
        spans += files.keyframes[name].spans()
    return spans


def _camera(files: AffFiles, time: float) -> Camera | None:
    """Return the view of the keyframes ``camera``, completed by the block ``v``."""
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
        raise FileFormatError(files.path, f"invalid view ({error})") from None


def _camera_track(files: AffFiles, camera: Camera) -> CameraTrack | None:
    """Return the track of the keyframes ``camera``; `camera` gives what they do not animate."""
    keys = files.keyframes.get("camera", Keyframes())
    if keys.translation is None and keys.rotation is None:
        return None
    try:
        return CameraTrack(camera, keys.translation, keys.rotation)
    except ValueError as error:
        raise FileFormatError(files.path, f"invalid keys of the camera ({error})") from None
