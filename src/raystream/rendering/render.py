"""render: from a scene to an image, by any of the renderers."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from os import PathLike
from typing import Any

from raystream.core.choices import DeviceOptions
from raystream.jit.threads import Progress
from raystream.rendering.ao import AO
from raystream.rendering.arguments import check_camera, check_samples, check_size, make_tracer
from raystream.rendering.image import Image
from raystream.rendering.integrator import Integrator, make_context
from raystream.rendering.kajiya import KAJIYA
from raystream.rendering.layers import choose_layers
from raystream.rendering.lighting import check_lights
from raystream.rendering.path import PATH
from raystream.rendering.progressive import Limits, render_samples
from raystream.rendering.raycast import RAYCAST
from raystream.rendering.sampling.sampler import Sampler
from raystream.rendering.shadow import SHADOW
from raystream.rendering.vis import VIS
from raystream.rendering.whitted import WHITTED
from raystream.rendering.xray import XRAY
from raystream.scene.camera import Camera
from raystream.scene.scene import Scene
from raystream.structures import StructureOptions
from raystream.tracer import Tracer

__all__ = ["MODES", "RENDERERS", "render"]

RENDERERS: dict[str, Integrator] = {
    renderer.name: renderer for renderer in (RAYCAST, VIS, SHADOW, WHITTED, XRAY, AO, KAJIYA, PATH)
}

#: What each mode shows, by its name.
MODES: dict[str, str] = {name: renderer.description for name, renderer in RENDERERS.items()}


def render(
    scene: Scene | Tracer,
    mode: str = "raycast",
    size: tuple[int, int] = (1024, 768),
    samples: int = 1,
    structure: str | StructureOptions = "bvh",
    device: str | DeviceOptions = "cpu",
    *,
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
    """Render a picture of a scene.

    Parameters
    ----------
    scene : Scene or Tracer
        A tracer saves building the structure again for every picture.
    mode : {"raycast", "vis", "shadow", "whitted", "xray", "ao", "kajiya", "path"}
        The renderer, see `MODES`. The default draws lit surfaces without shadows, at the least
        cost; ``"whitted"`` has shadows, mirrors and glass, ``"path"`` all light.
    size : (int, int)
        Width and height in pixels.
    samples : int
        Rays for each pixel. One goes through the centre; more smooth the edges.
    structure, device
        See `Tracer`; not to be given together with one.
    **options
        The renderer's own: ``max_bounces``, surfaces that may scatter light on its way
        (``"path"`` and ``"whitted"``: 8, ``"kajiya"``: 3); ``min_weight``, below which rays end
        (``"whitted"``: 1/512); ``light_samples=False`` finds lights by chance only
        (``"path"``); ``clamp``, the most that light over two surfaces or more may add to a
        sample at once (``"path"`` and ``"kajiya"``: inf); ``rays``, from each point, and their
        length ``distance`` (``"ao"``: 32, a tenth of the diagonal of the scene's box; inf for
        no end); ``opacity`` of a sheet, or ``absorption`` of
        solids for each world length (``"xray"``: 0.2, None). Others are for the tracer.
    camera : Camera, optional
        The view; without it, the scene's, or one that frames it.
    lights : {"auto", "file"}
        ``"auto"`` adds a light where the scene has none, or only such as are too weak to see
        by: a white sky (``"path"``, ``"kajiya"``), or a light at the eye (``"raycast"``,
        ``"shadow"``, ``"whitted"``); see `lighting.needs_light` for the measure. ``"file"``
        takes the scene's own lights alone.
    seed : int
        For the samples: the same seed gives the same picture, on any number of threads.
    noise, time_limit : float, optional
        Stop before all samples are taken once the picture's estimated relative error is as
        small, or so many seconds are over; see `progressive.Limits`.
    sampler : {"sobol", "stratified", "random"}
        Where the numbers of samples come from.
    layers : list of {"depth", "normal", "albedo", "prim_id", "emission"}, or "all", optional
        Layers that the image gets beside ``variance`` and ``samples``: what the pixels' samples
        see first, their mean and, of ``prim_id``, the first sample's. Depth is the distance
        from where the ray starts, inf where nothing is seen; normals are in world space and
        face the eye; albedo is what part of light a surface sends on in any way; prim_id is -1
        where nothing is seen; emission is the light that needs no further ray. The picture has
        the same bits with them as without.
    checkpoint : path, optional
        A file that keeps the samples, and from which a picture that was broken off goes on;
        see `progressive.render_samples`.
    on_pass : callable, optional
        Called with the picture so far, every 10 seconds.
    progress : callable, optional
        Called with (rays done, rays). An exception that it raises ends the rendering.

    Returns
    -------
    Image
        Linear RGB, with the layers ``variance`` and ``samples``, and those asked for.

    Raises
    ------
    ValueError
        If a name is unknown or a number out of range, or if the scene has more triangles or
        vertices than can be shaded.
    TypeError
        If `scene` is neither a scene nor a tracer, or `camera` no camera.
    MemoryError
        If so large a picture does not fit into memory.

    Examples
    --------
    >>> import raystream as rs
    >>> image = rs.render(rs.load("cornell"), size=(32, 24))
    >>> image.pixels.shape
    (24, 32, 3)
    """
    if mode not in RENDERERS:
        known = ", ".join(repr(known) for known in RENDERERS)
        raise ValueError(f"mode: expected one of {known}, got {mode!r}")
    width, height = check_size(size)
    samples = check_samples(samples)
    check_camera(camera)
    check_lights(lights)
    wanted = choose_layers(layers)
    renderer = RENDERERS[mode]
    limits = Limits(samples, noise, time_limit)
    own = {name: options.pop(name, usual) for name, usual in renderer.options.items()}
    chosen = renderer.check(own)
    numbers = Sampler.of(sampler, seed, samples)
    tracer = make_tracer(scene, structure, device, options)
    view = camera or tracer.scene.camera_for(width / height)
    context = make_context(tracer, view, (width, height), numbers, chosen, wanted, lights)
    return render_samples(
        renderer, context, limits, checkpoint=checkpoint, on_pass=on_pass, progress=progress
    )
