"""Scenes as visitors are told of them."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from raystream.scene.camera import Camera
from raystream.scene.load import load
from raystream.scene.projections import PROJECTIONS
from raystream.scene.scene import Scene
from raystream.viewer.jobs import Job, Jobs
from raystream.viewer.messages import Message, MessageError, read_choice, read_number, read_triple
from raystream.viewer.tracers import Tracers

__all__ = ["Staged", "camera_message", "read_camera", "stage"]

#: Names in messages are cut off here, and of many cameras only the first are told.
_LONGEST_NAME, _MOST_CAMERAS = 200, 100


class Staged(NamedTuple):
    """A scene that is shown.

    Attributes
    ----------
    scene : Scene
    name : str
    is_own : bool
        Whether it is one visitor's, and not everybody's.
    tracers : Tracers
    """

    scene: Scene
    name: str
    is_own: bool
    tracers: Tracers

    def message(self) -> Message:
        """What is in it."""
        scene = self.scene
        low, high = scene.bounds.tolist()
        cameras = [
            {"name": name[:_LONGEST_NAME], **camera_message(camera)}
            for name, camera in list(scene.cameras.items())[:_MOST_CAMERAS]
        ]
        return {
            "type": "scene",
            "name": self.name[:_LONGEST_NAME],
            "triangles": scene.triangle_count,
            "vertices": sum(len(mesh.vertices) for mesh in scene.meshes),
            "meshes": len(scene.meshes),
            "materials": len(scene.materials),
            "lights": len(scene.lights) + len(scene.area_lights),
            "low": low,
            "high": high,
            "camera": camera_message(scene.camera),
            "cameras": cameras,
            "own": self.is_own,
        }


def stage(path: Path, name: str, jobs: Jobs, job: Job) -> Staged:
    """Load a model that a visitor brings.

    Parameters
    ----------
    path : Path
    name : str
    jobs : Jobs
        Where its tracers will be built.
    job : Job
        That loads it.

    Raises
    ------
    FileFormatError
        If the file cannot be used.
    BrokenOffError
        If the job has been broken off.
    """
    job.begin(f"loading {name[:_LONGEST_NAME]}")
    scene = load(path)
    _ = scene.triangles  # made when first asked for
    job.begin(f"loading {name[:_LONGEST_NAME]}")  # or not, if it is not wanted any more
    return Staged(scene, name, True, Tracers(scene, jobs))


def camera_message(camera: Camera) -> Message:
    """A camera, for a message."""
    return {
        "eye": list(camera.eye),
        "look_at": list(camera.look_at),
        "up": list(camera.up),
        "fov": camera.fov,
        "projection": camera.projection,
        "height": camera.picture_height if camera.projection == "orthographic" else camera.height,
        "aperture": camera.aperture,
        "focus": camera.focus,
    }


def read_camera(message: Message) -> Camera:
    """The camera of a message.

    Raises
    ------
    MessageError
        If it is none.
    """
    projection = "perspective"
    if message.get("projection") is not None:
        projection = read_choice(message, "projection", PROJECTIONS)
    lengths = {
        name: read_number(message, name, 0.0, 1e30, above=name != "aperture")
        for name in ("height", "aperture", "focus")
        if message.get(name) is not None
    }
    try:
        return Camera(
            eye=read_triple(message, "eye"),
            look_at=read_triple(message, "look_at"),
            up=read_triple(message, "up"),
            fov=read_number(message, "fov", 0.0, 180.0, above=True),
            projection=projection,
            **lengths,
        )
    except MessageError:
        raise
    except ValueError as error:
        raise MessageError(str(error)) from None
