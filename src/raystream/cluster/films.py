"""render_frames: films whose frames are the workers' units of work."""

from __future__ import annotations

import json
import threading
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from raystream.cluster.clients import opened, thread_total
from raystream.cluster.fetching import fetch, tracer_of
from raystream.cluster.post import Post, post_of
from raystream.cluster.shares import own_share
from raystream.cluster.tasks import OrderedTasks
from raystream.cluster.tracers import (
    pack_scene_for,
    pack_tracer,
    unpack_scene_from,
    unpack_tracer,
)
from raystream.core.choices import DeviceOptions
from raystream.jit.threads import Progress
from raystream.rendering.arguments import check_samples, check_size
from raystream.rendering.frames import frame_seed, split_options, timeline_of
from raystream.rendering.image import Image
from raystream.rendering.picture import render
from raystream.scene.animation import Timeline
from raystream.scene.camera import Camera
from raystream.scene.camera_track import CameraMotion
from raystream.scene.moving import have_same_faces
from raystream.scene.scene import Scene
from raystream.structures import StructureOptions
from raystream.tracer import Tracer

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["render_frame", "render_frames"]

#: Frames for each thread of the workers, under way or done and not handed out.
FRAMES_PER_THREAD = 2

Picture = tuple[NDArray[np.float32], dict[str, NDArray[Any]], dict[str, Any]]

#: A tracer of this thread alone, which moves from frame to frame, and the parcel it is of.
_moving = threading.local()


def render_frames(
    scene: Scene,
    mode: str = "raycast",
    frames: slice | int | Iterable[int] | None = None,
    size: tuple[int, int] = (1024, 768),
    samples: int = 1,
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
    """Render the frames of a scene that moves on a cluster, with one machine's bits.

    Each frame is rendered by one worker, as a whole; frames come in order. The built structure
    goes to each worker once. Of a frame, only arrays travel that a worker has not got, such as
    the vertices of meshes that moved; it moves its structure to them. (Animations do not travel:
    they are asked here.)

    Parameters
    ----------
    client : distributed.Client or str, optional
        See `raystream.cluster.Tracer`. What an address starts here ends with the last frame.
    scene, mode, frames, size, samples, structure, device, fps, camera, seed, **options
        See `raystream.render_frames`.
    progress : callable, optional
        Called with (rays done, rays) of all frames, after each.

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
    Fewer frames than workers leave some idle: `raystream.cluster.render` spreads one picture.

    Examples
    --------
    >>> import raystream as rs
    >>> film = rs.cluster.render_frames(rs.load("robots.aff"), client="local:2")  # doctest: +SKIP
    >>> for frame, image in film:  # doctest: +SKIP
    ...     image.save(f"{frame:04}.png")
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"scene: expected a Scene, got {type(scene).__name__}; see rs.load")
    width, height = check_size(size)
    of_picture, of_tracer = split_options(mode, options)
    timeline = timeline_of(scene, camera, fps)
    numbers = timeline.chosen(frames)
    if camera is None and not scene.has_own_camera:
        camera = scene.camera_for(width / height)
    of_picture |= {"mode": mode, "size": (width, height), "samples": check_samples(samples)}
    film = _Film(scene, timeline, numbers, camera, seed, of_picture, structure, device, of_tracer)

    def pictures() -> Iterator[tuple[int, Image]]:
        rays = width * height * samples
        with opened(client) as found:
            sender = _Sender(post_of(found), film)
            window = FRAMES_PER_THREAD * thread_total(found)
            tasks = OrderedTasks(found, render_frame, sender.calls(), window, f"frame-{mode}")
            try:
                for done, (number, picture) in enumerate(zip(numbers, tasks, strict=True), 1):
                    sender.release()
                    if progress is not None:
                        progress(done * rays, len(numbers) * rays)
                    yield number, Image(*picture)
            finally:
                tasks.close()
                sender.close()

    return pictures()


@dataclass(frozen=True)
class _Film:
    """What is to be filmed."""

    scene: Scene
    timeline: Timeline
    numbers: tuple[int, ...]
    camera: Camera | CameraMotion | None
    seed: int
    of_picture: Mapping[str, Any]
    structure: str | StructureOptions
    device: str | DeviceOptions
    of_tracer: Mapping[str, Any]

    def picture(self, number: int, scene: Scene) -> str:
        """What `render` is to be given for a frame, as JSON."""
        width, height = self.of_picture["size"]
        view = self.camera
        if view is None:
            view = scene.camera_for(width / height)
        elif not isinstance(view, Camera):
            view = view.at(self.timeline.time_of(number))
        asked = {
            **self.of_picture,
            "camera": asdict(view),
            "seed": frame_seed(self.seed, number),
        }
        layers = asked.get("layers")
        if layers is not None and not isinstance(layers, str):
            asked["layers"] = list(layers)
        return json.dumps(asked, default=float)


class _Sender:
    """Sends what frames need as their turn comes, and lets go of it when they are done."""

    def __init__(self, post: Post, film: _Film) -> None:
        self._post = post
        self._film = film
        self._base: tuple[Scene, str] | None = None
        self._under_way: list[tuple[str, str]] = []  # of each frame: base, own parcel
        self._users: Counter[str] = Counter()

    def calls(self) -> Iterator[tuple[str, str, str]]:
        """Arguments of `render_frame`, frame by frame."""
        film = self._film
        for number in film.numbers:
            scene = film.scene.at(film.timeline.time_of(number))
            base = self._base_of(scene)
            own = base[1]
            if not _is_same(base[0], scene):
                own = self._post.send(pack_scene_for(scene))
            self._under_way.append((base[1], own))
            self._users[base[1]] += 1
            yield base[1], own, film.picture(number, scene)

    def release(self) -> None:
        """Let go of what only the frame needed that was handed out last."""
        base, own = self._under_way.pop(0)
        if own != base:
            self._post.release(own)
        self._users[base] -= 1
        if not self._users[base] and (self._base is None or self._base[1] != base):
            self._post.release(base)

    def close(self) -> None:
        """Let go of everything."""
        if self._base is not None:
            current, self._base = self._base[1], None
            if not self._users[current]:
                self._post.release(current)
        while self._under_way:
            self.release()

    def _base_of(self, scene: Scene) -> tuple[Scene, str]:
        """The scene, and the parcel of its tracer, that workers move to this one."""
        base = self._base
        if base is None or not have_same_faces(base[0].meshes, scene.meshes):
            film = self._film
            parcel = pack_tracer(
                scene, film.structure, film.device, film.of_tracer, for_pictures=True
            )
            last, self._base = base, (scene, self._post.send(parcel))
            if last is not None and not self._users[last[1]]:
                self._post.release(last[1])
            return self._base
        return base


def _is_same(scene: Scene, other: Scene) -> bool:
    """Whether nothing of a scene differs but the camera."""
    parts = (
        (scene.meshes, other.meshes),
        (scene.materials, other.materials),
        (scene.lights, other.lights),
    )
    return all(list(map(id, one)) == list(map(id, two)) for one, two in parts)


def render_frame(base: str, own: str, picture: str) -> Picture:
    """Render a frame; on a worker.

    Parameters
    ----------
    base : str
        Parcel of a tracer of the same meshes, in another place.
    own : str
        Parcel of the frame's scene; the same where it is just that.
    picture : str
        What `render` is given, as JSON.

    Returns
    -------
    pixels, layers, figures
        Of the `Image`.
    """
    asked = json.loads(picture)
    asked["size"] = tuple(asked["size"])
    asked["camera"] = Camera(**asked["camera"])
    with own_share():
        tracer = tracer_of(base) if own == base else _moved(base, own)
        image = render(tracer, **asked)
    return image.pixels, dict(image.layers), dict(image.figures)


def _moved(base: str, own: str) -> Tracer:
    """The tracer of this thread, with a frame's scene."""
    if getattr(_moving, "base", None) != base:
        header, arrays = fetch(base)
        # Moving changes a structure's arrays, which other threads may have, too.
        own_arrays = {n: a.copy() if n.startswith("structure ") else a for n, a in arrays.items()}
        _moving.tracer, _moving.base = unpack_tracer(header, own_arrays), base
    tracer: Tracer = _moving.tracer
    try:
        tracer.update(unpack_scene_from(*fetch(own)))
    except BaseException:
        _moving.base = None  # it may be half moved
        raise
    return tracer
