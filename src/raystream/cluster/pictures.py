"""render: pictures whose samples the workers of a cluster take."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable
from os import PathLike
from typing import TYPE_CHECKING, Any

from raystream.cluster.clients import opened
from raystream.cluster.errors import ClusterError
from raystream.cluster.post import post_of
from raystream.cluster.samples import Samples, picture_text
from raystream.cluster.tracers import pack_tracer
from raystream.core.choices import DeviceOptions
from raystream.jit.threads import Progress
from raystream.rendering.arguments import check_camera, check_samples, check_size
from raystream.rendering.image import Image
from raystream.rendering.layers import choose_layers
from raystream.rendering.lighting import check_lights
from raystream.rendering.picture import RENDERERS
from raystream.rendering.progressive import Limits, render_samples
from raystream.rendering.sampled import make_setting
from raystream.rendering.sampling.sampler import Sampler
from raystream.scene.camera import Camera
from raystream.scene.scene import Scene
from raystream.structures import StructureOptions
from raystream.tracer import Tracer

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["render"]


def render(
    scene: Scene | Tracer,
    mode: str = "raycast",
    size: tuple[int, int] = (1024, 768),
    samples: int = 1,
    structure: str | StructureOptions = "bvh",
    device: str | DeviceOptions = "cpu",
    *,
    client: Client | str | None = None,
    camera: Camera | None = None,
    lights: str = "auto",
    seed: int = 0,
    noise: float | None = None,
    time_limit: float | None = None,
    sampler: str = "sobol",
    layers: str | Iterable[str] | None = None,
    checkpoint: str | PathLike[str] | None = None,
    on_pass: Callable[[Image], object] | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> Image:
    """Render a picture on a cluster: `raystream.render`'s, to the bit.

    The workers take samples of rows, and here they are added in their order. So the picture does
    not depend on how many workers there are, nor on which of them fail: what a lost worker had
    begun, another one does. Some samples are under way at a time; the rest of the memory is as
    `raystream.render` needs it.

    Parameters
    ----------
    scene : Scene or Tracer
        A tracer of the CPU saves building the structure again.
    client : distributed.Client or str, optional
        See `raystream.cluster.Tracer`. What an address starts here ends with the picture.
    mode, size, samples, structure, device, camera, lights, seed, sampler, layers, **options
        See `raystream.render`.
    noise, time_limit : float, optional
        As `raystream.render`: a noise limit ends with the same sample. Of samples that are under
        way when the time is over, only those count that were added.
    checkpoint : path, optional
        A file of this machine, see `raystream.render`: a picture can go on from it with a cluster
        or without. It is also written when the cluster is lost.
    on_pass, progress : callable, optional
        As `raystream.render`; called here.

    Returns
    -------
    Image

    Raises
    ------
    ClusterError
        If there is no cluster or it has no workers; if it is lost; or if one piece of work kills
        worker after worker.
    ValueError, TypeError, MemoryError
        As `raystream.render`.

    Warns
    -----
    RaystreamWarning
        While all workers are gone, until one comes.

    Examples
    --------
    >>> import raystream as rs
    >>> image = rs.cluster.render(
    ...     rs.load("cornell"), "path", samples=64, client="tcp://127.0.0.1:8786"
    ... )  # doctest: +SKIP
    """
    if mode not in RENDERERS:
        known = ", ".join(repr(known) for known in RENDERERS)
        raise ValueError(f"mode: expected one of {known}, got {mode!r}")
    width, height = check_size(size)
    limits = Limits(check_samples(samples), noise, time_limit)
    check_camera(camera)
    check_lights(lights)
    wanted = choose_layers(layers)
    renderer = RENDERERS[mode]
    own = {name: options.pop(name, usual) for name, usual in renderer.options.items()}
    chosen = renderer.check(own)
    numbers = Sampler.of(sampler, seed, limits.samples)
    parcel = pack_tracer(scene, structure, device, options, for_pictures=True)
    here = scene if isinstance(scene, Tracer) else Tracer(scene, "brute")  # nothing traces here
    view = camera or here.scene.camera_for(width / height)
    setting = make_setting(here, view, (width, height), numbers, chosen, wanted, lights)
    drawn = sampler, seed, limits.samples
    picture = picture_text(mode, (width, height), view, drawn, own, wanted, lights)
    with opened(client) as found:
        post = post_of(found)
        digest = post.send(parcel)
        taken = Samples(found, digest, picture, setting, limits.samples)
        try:
            return render_samples(
                renderer,
                setting,
                limits,
                checkpoint=checkpoint,
                on_pass=on_pass,
                progress=progress,
                take=taken.take,
            )
        finally:
            taken.close()
            with contextlib.suppress(ClusterError):  # the picture matters more
                post.release(digest)
