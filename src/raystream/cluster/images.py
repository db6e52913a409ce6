"""render: one image, with its samples traced by the workers of a cluster."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable
from os import PathLike
from typing import TYPE_CHECKING, Any

from raystream.cluster.clients import open_client
from raystream.cluster.errors import ClusterError
from raystream.cluster.samples import Samples, image_spec
from raystream.cluster.tracer_bundles import pack_tracer
from raystream.cluster.uploader import uploader_of
from raystream.core.choices import DeviceOptions
from raystream.jit.threads import Progress
from raystream.rendering.image import Image
from raystream.rendering.layers import choose_layers
from raystream.rendering.limits import Limits
from raystream.rendering.progressive import render_samples
from raystream.rendering.render import checked_renderer
from raystream.rendering.sampling.sampler import Sampler
from raystream.rendering.view_light import decide
from raystream.scene.camera import Camera
from raystream.scene.scene import Scene
from raystream.structures import StructureOptions
from raystream.tracer import Tracer

if TYPE_CHECKING:
    from distributed import Client


def render(
    scene: Scene | Tracer,
    mode: str = "path",
    size: tuple[int, int] = (1024, 768),
    samples: int | None = None,
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
    """Render an image on a cluster, identical to the bit to `raystream.render`.

    Workers trace samples of rows, and this process adds them in order. The image therefore does
    not depend on the number of workers or on their failures: work of a lost worker is repeated
    by another. A few samples are in flight at a time; otherwise memory use is that of
    `raystream.render`.

    Parameters
    ----------
    scene : Scene or Tracer
        Passing a CPU tracer avoids rebuilding the structure.
    client : distributed.Client or str, optional
        See `raystream.cluster.Tracer`. Workers started for an address stop when the image is
        complete.
    mode, size, samples, structure, device, camera, lights, seed, sampler, layers, **options
        See `raystream.render`.
    noise, time_limit : float, optional
        As `raystream.render`: a noise limit stops at the same sample. When the time limit is
        reached, samples still in flight are discarded.
    checkpoint : path, optional
        A file on this machine, see `raystream.render`: the render can be resumed with or without a
        cluster. It is also written when the cluster is lost.
    on_pass, progress : callable, optional
        As `raystream.render`; called in this process.

    Returns
    -------
    Image

    Raises
    ------
    ClusterError
        If there is no cluster or it has no workers; if it is lost; or if one task kills
        worker after worker.
    ValueError, TypeError, MemoryError
        As `raystream.render`.

    Warns
    -----
    RaystreamWarning
        While there are no workers, until one joins; and as `raystream.render`.

    Examples
    --------
    >>> import raystream as rs
    >>> image = rs.cluster.render(
    ...     rs.load("cornell"), "path", samples=64, client="tcp://127.0.0.1:8786"
    ... )  # doctest: +SKIP
    """
    renderer, size, given = checked_renderer(mode, size, camera, lights, options)
    wanted = choose_layers(layers)
    limits = Limits(renderer.samples(samples, noise, time_limit, sampler), noise, time_limit)
    own = renderer.complete(given)
    chosen = renderer.check(own)
    numbers = Sampler.of(sampler, seed, limits.samples)
    bundle = pack_tracer(scene, structure, device, options, for_rendering=True)
    # Only the choice of lights is traced in this process: its warning and checkpoints need it.
    here = Tracer(scene, "brute") if isinstance(scene, Scene) else scene
    context = decide(renderer, here, camera, size, numbers, chosen, wanted, lights)
    drawn, view = (sampler, seed, limits.samples), context.camera
    spec = image_spec(mode, size, view, drawn, own, wanted, context.chosen_lights)
    with open_client(client) as found:
        uploader = uploader_of(found)
        digest = uploader.send(bundle)
        taken = Samples(found, digest, spec, context, limits.samples)
        try:
            return render_samples(
                renderer,
                context,
                limits,
                checkpoint=checkpoint,
                on_pass=on_pass,
                progress=progress,
                source=taken,
            )
        finally:
            taken.close()
            with contextlib.suppress(ClusterError):  # returning the image matters more
                uploader.release(digest)
