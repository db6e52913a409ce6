"""render_frames: animations on a cluster, one task per frame."""

from __future__ import annotations

import json
import threading
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from raystream.cluster.clients import open_client, thread_total
from raystream.cluster.fetch import fetch, tracer_of
from raystream.cluster.tasks import OrderedTasks
from raystream.cluster.thread_budget import shared_threads
from raystream.cluster.tracer_bundles import (
    pack_scene_for,
    pack_tracer,
    unpack_scene_from,
    unpack_tracer,
)
from raystream.cluster.uploader import Uploader, uploader_of
from raystream.core.choices import DeviceOptions
from raystream.jit.threads import Progress
from raystream.rendering.arguments import check_size
from raystream.rendering.frames import frame_seed, sample_count_of, split_options, timeline_of
from raystream.rendering.image import Image
from raystream.rendering.render import render
from raystream.scene.animation import Timeline
from raystream.scene.camera import Camera
from raystream.scene.camera_track import CameraMotion
from raystream.scene.moving import have_same_faces
from raystream.scene.scene import Scene
from raystream.structures import StructureOptions
from raystream.tracer import Tracer

if TYPE_CHECKING:
    from distributed import Client

#: Frames in flight per worker thread: running, or finished and not yet returned.
FRAMES_PER_THREAD = 2

FrameArrays = tuple[NDArray[np.float32], dict[str, NDArray[Any]], dict[str, Any]]

#: This thread's own tracer, which moves from frame to frame, and the bundle it came from.
_moving = threading.local()


def render_frames(
    scene: Scene,
    mode: str = "path",
    frames: slice | int | Iterable[int] | None = None,
    size: tuple[int, int] = (1024, 768),
    samples: int | None = None,
    structure: str | StructureOptions = "bvh",
    device: str | DeviceOptions = "cpu",
    *,
    client: Client | str | None = None,
    fps: float | None = None,
    camera: Camera | CameraMotion | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    **options: Any,
) -> Iterator[tuple[int, Image]]:
    """Render the frames of an animated scene on a cluster, with the same bits as one machine.

    Each frame is one task; frames are returned in order. The built structure is sent to each
    worker once. Per frame, only arrays that a worker lacks are sent, such as the vertices of
    meshes that moved; the worker updates its structure with them. Animations themselves are
    evaluated on the client.

    Parameters
    ----------
    client : distributed.Client or str, optional
        See `raystream.cluster.Tracer`. Workers started for an address stop after the last frame.
    scene, mode, frames, size, samples, structure, device, fps, camera, seed, **options
        See `raystream.render_frames`.
    progress : callable, optional
        Called with (rays done, rays) over all frames, after each frame.

    Returns
    -------
    iterator of (int, Image)

    Raises
    ------
    ClusterError
        See `raystream.cluster.render`.
    ValueError, TypeError
        As `raystream.render_frames`.

    Notes
    -----
    Fewer frames than workers leave some idle: `raystream.cluster.render` distributes one image.

    Examples
    --------
    >>> import raystream as rs
    >>> frames = rs.cluster.render_frames(rs.load("robots.aff"), client="local:2")  # doctest: +SKIP
    >>> for frame, image in frames:  # doctest: +SKIP
    ...     image.save(f"{frame:04}.png")
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"scene: expected a Scene, got {type(scene).__name__}; see rs.load")
    width, height = check_size(size)
    of_image, of_tracer = split_options(mode, options)
    sample_count = sample_count_of(mode, samples, of_image)
    timeline = timeline_of(scene, camera, fps)
    numbers = timeline.chosen(frames)
    if camera is None and not scene.has_own_camera:
        camera = scene.camera_for(width / height)
    of_image |= {"mode": mode, "size": (width, height), "samples": sample_count}
    animation = _Animation(
        scene, timeline, numbers, camera, seed, of_image, structure, device, of_tracer
    )

    def images() -> Iterator[tuple[int, Image]]:
        rays = width * height * sample_count
        with open_client(client) as found:
            sender = _Sender(uploader_of(found), animation)
            window = FRAMES_PER_THREAD * thread_total(found)
            tasks = OrderedTasks(found, render_frame, sender.calls(), window, f"frame-{mode}")
            try:
                for done, (number, arrays) in enumerate(zip(numbers, tasks, strict=True), 1):
                    sender.release()
                    if progress is not None:
                        progress(done * rays, len(numbers) * rays)
                    yield number, Image(*arrays)
            finally:
                tasks.close()
                sender.close()

    return images()


@dataclass(frozen=True)
class _Animation:
    """Arguments of an animation render."""

    scene: Scene
    timeline: Timeline
    numbers: tuple[int, ...]
    camera: Camera | CameraMotion | None
    seed: int
    of_image: Mapping[str, Any]
    structure: str | StructureOptions
    device: str | DeviceOptions
    of_tracer: Mapping[str, Any]

    def image_spec(self, number: int, scene: Scene) -> str:
        """Return the arguments of `render` for a frame, as JSON."""
        width, height = self.of_image["size"]
        view = self.camera
        if view is None:
            view = scene.camera_for(width / height)
        elif not isinstance(view, Camera):
            view = view.at(self.timeline.time_of(number))
        asked = {
            **self.of_image,
            "camera": asdict(view),
            "seed": frame_seed(self.seed, number),
        }
        layers = asked.get("layers")
        if layers is not None and not isinstance(layers, str):
            asked["layers"] = list(layers)
        return json.dumps(asked, default=float)


class _Sender:
    """Uploads what frames need in order, and releases it when they are done."""

    def __init__(self, uploader: Uploader, animation: _Animation) -> None:
        self._uploader = uploader
        self._animation = animation
        self._base: tuple[Scene, str] | None = None
        self._under_way: list[tuple[str, str]] = []  # of each frame: base and own bundle
        self._users: Counter[str] = Counter()

    def calls(self) -> Iterator[tuple[str, str, str]]:
        """Iterate over the arguments of `render_frame`, frame by frame."""
        animation = self._animation
        for number in animation.numbers:
            scene = animation.scene.at(animation.timeline.time_of(number))
            base = self._base_of(scene)
            own = base[1]
            if not _is_same(base[0], scene):
                own = self._uploader.send(pack_scene_for(scene))
            self._under_way.append((base[1], own))
            self._users[base[1]] += 1
            yield base[1], own, animation.image_spec(number, scene)

    def release(self) -> None:
        """Release what only the frame returned last needed."""
        base, own = self._under_way.pop(0)
        if own != base:
            self._uploader.release(own)
        self._users[base] -= 1
        if not self._users[base] and (self._base is None or self._base[1] != base):
            self._uploader.release(base)

    def close(self) -> None:
        """Release everything."""
        if self._base is not None:
            current, self._base = self._base[1], None
            if not self._users[current]:
                self._uploader.release(current)
        while self._under_way:
            self.release()

    def _base_of(self, scene: Scene) -> tuple[Scene, str]:
        """Return the scene, and its tracer's bundle, that workers update to this scene."""
        base = self._base
        if base is None or not have_same_faces(base[0].meshes, scene.meshes):
            animation = self._animation
            bundle = pack_tracer(
                scene,
                animation.structure,
                animation.device,
                animation.of_tracer,
                for_rendering=True,
            )
            last, self._base = base, (scene, self._uploader.send(bundle))
            if last is not None and not self._users[last[1]]:
                self._uploader.release(last[1])
            return self._base
        return base


def _is_same(scene: Scene, other: Scene) -> bool:
    """Whether two scenes are the same except for the camera."""
    parts = (
        (scene.meshes, other.meshes),
        (scene.materials, other.materials),
        (scene.lights, other.lights),
    )
    return all(list(map(id, one)) == list(map(id, two)) for one, two in parts)


def render_frame(base: str, own: str, image_spec: str) -> FrameArrays:
    """Render a frame on a worker.

    Parameters
    ----------
    base : str
        Bundle of a tracer of the same meshes at another time.
    own : str
        Bundle of the frame's scene; equal to `base` if that is the scene itself.
    image_spec : str
        Arguments of `render`, as JSON.

    Returns
    -------
    pixels, layers, figures
        Those of the `Image`.
    """
    asked = json.loads(image_spec)
    asked["size"] = tuple(asked["size"])
    asked["camera"] = Camera(**asked["camera"])
    with shared_threads():
        tracer = tracer_of(base) if own == base else _moved(base, own)
        image = render(tracer, **asked)
    return image.pixels, dict(image.layers), dict(image.figures)


def _moved(base: str, own: str) -> Tracer:
    """Return this thread's tracer, updated to a frame's scene."""
    if getattr(_moving, "base", None) != base:
        header, arrays = fetch(base)
        # Updates change a structure's arrays in place, and other threads may share them.
        own_arrays = {n: a.copy() if n.startswith("structure.") else a for n, a in arrays.items()}
        _moving.tracer, _moving.base = unpack_tracer(header, own_arrays), base
    tracer: Tracer = _moving.tracer
    try:
        tracer.update(unpack_scene_from(*fetch(own)))
    except BaseException:
        _moving.base = None  # it may be partly updated
        raise
    return tracer
