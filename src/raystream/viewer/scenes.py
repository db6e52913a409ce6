"""Scenes of the viewer, and their messages."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from raystream.scene.camera import Camera
from raystream.scene.load import load
from raystream.scene.projections import PROJECTIONS
from raystream.scene.scene import Scene
from raystream.viewer.jobs import Job, Jobs
from raystream.viewer.messages import Message, MessageError, read_choice, read_number, read_vector
from raystream.viewer.tracers import TracerCache

#: Limits of messages: length of names, and number of cameras.
_MAX_NAME_LENGTH, _MAX_CAMERAS = 200, 100


class LoadedScene(NamedTuple):
    """A scene that is loaded and can be shown.

    Attributes
    ----------
    scene : Scene
    name : str
    is_own : bool
        Whether it belongs to one client rather than to all.
    tracers : TracerCache
    """

    scene: Scene
    name: str
    is_own: bool
    tracers: TracerCache

    def message(self) -> Message:
        """Describe the scene."""
        scene = self.scene
        low, high = scene.bounds.tolist()
        cameras = [
            {"name": name[:_MAX_NAME_LENGTH], **camera_message(camera)}
            for name, camera in list(scene.cameras.items())[:_MAX_CAMERAS]
        ]
        return {
            "type": "scene",
            "name": self.name[:_MAX_NAME_LENGTH],
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


def load_model(path: Path, name: str, jobs: Jobs, job: Job) -> LoadedScene:
    """Load a model uploaded by a client.

    Parameters
    ----------
    path : Path
    name : str
    jobs : Jobs
        Runs the building of its tracers.
    job : Job
        The job that loads it.

    Raises
    ------
    FileFormatError
        If the file cannot be read.
    WorkCancelledError
        If the job has been cancelled.
    """
    job.begin(f"loading {name[:_MAX_NAME_LENGTH]}")
    scene = load(path)
    _ = scene.triangles  # computed on first use
    job.begin(f"loading {name[:_MAX_NAME_LENGTH]}")  # checks for cancellation
    return LoadedScene(scene, name, True, TracerCache(scene, jobs))


def camera_message(camera: Camera) -> Message:
    """Describe a camera in a message."""
    return {
        "eye": list(camera.eye),
        "look_at": list(camera.look_at),
        "up": list(camera.up),
        "fov": camera.fov,
        "projection": camera.projection,
        "height": camera.image_height if camera.projection == "orthographic" else camera.height,
        "aperture": camera.aperture,
        "focus": camera.focus,
    }


def read_camera(message: Message) -> Camera:
    """Read the camera of a message.

    Raises
    ------
    MessageError
        If it is invalid.
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
            eye=read_vector(message, "eye"),
            look_at=read_vector(message, "look_at"),
            up=read_vector(message, "up"),
            fov=read_number(message, "fov", 0.0, 180.0, above=True),
            projection=projection,
            **lengths,
        )
    except MessageError:
        raise
    except ValueError as error:
        raise MessageError(str(error)) from None
