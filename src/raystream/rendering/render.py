"""render: render an image of a scene, in any mode."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from os import PathLike
from typing import Any

from raystream.core.checks import check_choice
from raystream.core.choices import DeviceOptions
from raystream.jit.threads import Progress
from raystream.rendering.ao import AO
from raystream.rendering.arguments import check_camera, check_size, make_tracer
from raystream.rendering.image import Image
from raystream.rendering.integrator import Integrator
from raystream.rendering.kajiya import KAJIYA
from raystream.rendering.layers import choose_layers
from raystream.rendering.lighting import check_lights
from raystream.rendering.limits import Limits
from raystream.rendering.path import PATH
from raystream.rendering.progressive import render_samples
from raystream.rendering.raycast import RAYCAST
from raystream.rendering.sampling.sampler import Sampler
from raystream.rendering.shadow import SHADOW
from raystream.rendering.view_light import decide
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

#: Description of each mode, by its name.
MODES: dict[str, str] = {name: renderer.description for name, renderer in RENDERERS.items()}


def checked_renderer(
    mode: str,
    size: tuple[int, int],
    camera: Camera | None,
    lights: str,
    options: dict[str, Any],
) -> tuple[Integrator, tuple[int, int], dict[str, Any]]:
    """The renderer of a mode, the size of an image, and the mode's options, which are taken out.

    Raises
    ------
    ValueError, TypeError, MemoryError
        See `render`.
    """
    check_choice("mode", mode, RENDERERS)
    size = check_size(size)
    check_camera(camera)
    check_lights(lights)
    renderer = RENDERERS[mode]
    own = [name for name in (*renderer.options, "preset") if name in options]
    return renderer, size, {name: options.pop(name) for name in own}


def render(
    scene: Scene | Tracer,
    mode: str = "path",
    size: tuple[int, int] = (1024, 768),
    samples: int | None = None,
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
    """Render an image of a scene.

    Parameters
    ----------
    scene : Scene or Tracer
        A tracer avoids rebuilding the structure for every image.
    mode : {"raycast", "vis", "shadow", "whitted", "xray", "ao", "kajiya", "path"}
        See `MODES`. ``"path"`` renders global illumination; ``"raycast"``, the fastest, shades
        surfaces without shadows; ``"whitted"`` adds shadows, mirrors and glass.
    size : (int, int)
        Width and height in pixels.
    samples : int, optional
        Rays per pixel. One goes through the centre; more reduce aliasing and noise [default: 16
        for ``"path"`` and ``"kajiya"``, which have noise, else 1; with `noise` or `time_limit` at
        most 65,536].
    structure, device
        See `Tracer`; not allowed if `scene` is a tracer.
    **options
        Options of the mode: ``max_bounces``, the maximum number of surfaces that scatter light
        (``"path"`` and ``"whitted"``: 8, ``"kajiya"``: 3); ``min_weight``, below which rays end
        (``"whitted"``: 1/512); ``shadows=False``, without shadow rays (``"whitted"``);
        ``light_samples=False`` turns next-event estimation off, ``diffuse_only=True`` all
        reflection but the diffuse one, and ``preset="arnold"`` both, with two bounces: Purcell's
        path tracer (``"path"``); ``clamp``, a bound on the indirect light of a sample (``"path"``
        and ``"kajiya"``: inf); ``rays`` per hit, and their length ``distance`` (``"ao"``: 32, a
        tenth of the diagonal of the scene's bounds; inf for unlimited); ``opacity`` of a sheet, or
        ``absorption`` of solids per world unit, ``nested`` as in `thickness` (``"xray"``: 0.2,
        None, ``"both"``). All others are passed to the tracer.
    camera : Camera, optional
        The view [default: the scene's camera, or one chosen by `Scene.camera_for`].
    lights : {"auto", "file", "added"}
        ``"auto"`` adds a light if the scene has none, or if its lights are too weak to see
        anything: a sun and a sky (``"path"``, ``"kajiya"``), or a headlight (``"raycast"``,
        ``"shadow"``, ``"whitted"``); see `lighting.needs_light` for the criterion. If what the
        camera sees is dark nevertheless, as in a closed room, ``"path"`` and ``"kajiya"`` add all
        three; see `view_light.lit`. ``"file"`` uses the scene's lights only; ``"added"`` adds
        lights in any case.
    seed : int
        Seed of the samples: the same seed gives the same image, on any number of threads.
    noise, time_limit : float, optional
        Stop early once the image's estimated relative error is below `noise`, or after
        `time_limit` seconds; see `limits.Limits`. All pixels get the same number of samples, at
        most `samples`.
    sampler : {"sobol", "stratified", "random"}
        The random number generator of samples. With `noise` or `time_limit`, "stratified" also
        needs `samples`.
    layers : list of {"depth", "normal", "albedo", "prim_id", "emission"}, or "all", optional
        Extra layers (AOVs), in addition to ``variance`` and ``samples``: values at the first hits
        of the pixels' samples, averaged, or of the first sample for ``prim_id``. Depth is the
        distance from the ray's origin, inf for a miss; normals are in world space and face the
        camera; albedo is the diffuse and glossy reflectance; prim_id is -1 for a miss; emission is
        light that needs no secondary ray. The image has the same bits with or without layers.
    checkpoint : path, optional
        A file of samples, from which an interrupted image is resumed; see
        `progressive.render_samples`.
    on_pass : callable, optional
        Called with the image so far, every 10 seconds.
    progress : callable, optional
        Called with (rays done, rays). An exception that it raises ends the rendering.

    Returns
    -------
    Image
        Linear RGB, with the layers ``variance`` and ``samples``, and those requested.

    Raises
    ------
    ValueError
        If a name is unknown or a number out of range, or if the scene has more triangles or
        vertices than can be shaded.
    TypeError
        If `scene` is neither a scene nor a tracer, or `camera` is not a camera.
    MemoryError
        If the image does not fit into memory.

    Examples
    --------
    >>> import raystream as rs
    >>> image = rs.render(rs.load("cornell"), size=(32, 24))
    >>> image.pixels.shape
    (24, 32, 3)
    """
    renderer, size, own = checked_renderer(mode, size, camera, lights, options)
    wanted = choose_layers(layers)
    limits = Limits(renderer.samples(samples, noise, time_limit, sampler), noise, time_limit)
    chosen = renderer.check(renderer.complete(own))
    numbers = Sampler.of(sampler, seed, limits.samples)
    tracer = make_tracer(scene, structure, device, options)
    context = decide(renderer, tracer, camera, size, numbers, chosen, wanted, lights)
    return render_samples(
        renderer, context, limits, checkpoint=checkpoint, on_pass=on_pass, progress=progress
    )
