"""``raystream render``: render an image or an animation of a scene."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from raystream.cli import options
from raystream.cli.animations import (
    AnimationOptions,
    Fps,
    Frames,
    is_animation,
    refuse_beside_frames,
    render_animation,
)
from raystream.cli.bars import Bars
from raystream.cli.checkpoint import PathProgress, Resume, checkpoint_path, sample_checkpoint
from raystream.cli.clusters import Cluster, ImageRenderer, check_cluster, cluster_client
from raystream.cli.compiling import compiling
from raystream.cli.console import BadInputError, one_line, refuse, write_json, write_line
from raystream.cli.environment import (
    Environment,
    Lights,
    Rotation,
    check_environment,
    report_added_light,
    with_environment,
)
from raystream.cli.heatmaps import HeatmapKind, Maximum, check_heatmap, heatmap_figures
from raystream.cli.layers import Denoise, Layers, LayerSelection
from raystream.cli.load import Source, Stopwatch, choose_threads, open_tracer, rays_per_second
from raystream.cli.sampling import (
    MaxBounces,
    Noise,
    SamplerName,
    Samples,
    SamplingOptions,
    Seed,
    TimeLimit,
    mode_arguments,
)
from raystream.cli.tracer_options import machine_figures, tracer_options

if TYPE_CHECKING:
    from raystream.rendering.heatmap import Heatmap
    from raystream.rendering.image import Image

__all__ = ["DEFAULT_SCENE", "render"]

DEFAULT_SCENE = "robots"


def render(
    scene: options.SceneName = DEFAULT_SCENE,
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="Output file: .png or .exr; frames and videos with --frames.",
        ),
    ] = Path("out.png"),
    mode: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help=f"Renderer: {' or '.join(options.MODES)} [default: {options.MODES[0]}]",
            show_default=False,
            callback=options.one_of(options.MODES),
            autocompletion=options.complete(options.MODES),
        ),
    ] = None,
    heatmap: HeatmapKind = None,
    maximum: Maximum = None,
    frames: Frames = None,
    fps: Fps = None,
    size: Annotated[str, typer.Option(metavar="WIDTHxHEIGHT", help="Size in pixels.")] = "1024x768",
    samples: Samples = None,
    noise: Noise = None,
    time_limit: TimeLimit = None,
    max_bounces: MaxBounces = None,
    sampler: SamplerName = None,
    seed: Seed = 0,
    resume: Resume = False,
    camera: Annotated[
        str | None,
        typer.Option(
            metavar="PARTS",
            help="One of the scene's cameras by name or number (from 0), followed by the "
            "parameters to override, as in 'eye=3,2,1 look_at=0,0,0 up=0,1,0 fov=40' (vertical "
            "field of view in degrees); also projection=orthographic height=3 (or "
            "equirectangular), or a thin lens: aperture=0.1 focus=5.",
            show_default=False,
        ),
    ] = None,
    exposure: Annotated[
        float | None,
        typer.Option(
            metavar="FACTOR",
            callback=options.positive_if_given,
            help="Exposure factor for PNG output [default: 1]",
            show_default=False,
        ),
    ] = None,
    tone: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Tone curve for PNG output, applied after the exposure: "
            f"{' or '.join(options.TONES)} [default: {options.TONES[0]}]",
            show_default=False,
            callback=options.one_of(options.TONES),
            autocompletion=options.complete(options.TONES),
        ),
    ] = None,
    environment: Environment = None,
    environment_rotation: Rotation = None,
    lights: Lights = None,
    layers: Layers = None,
    denoise: Denoise = False,
    structure: options.Structure = None,
    traversal: options.Traversal = None,
    machine: options.Machine = None,
    scheduler: options.Scheduler = None,
    option: options.TracerOption = None,
    device: options.Device = "cpu",
    adapter: options.Adapter = None,
    gpu: options.Gpu = None,
    cluster: Cluster = None,
    threads: options.Threads = None,
    time: options.Time = 0.0,
    triangles: options.Triangles = None,
    json: options.Json = False,
) -> None:
    """Render an image of a scene. Without SCENE, renders robots in a city."""
    width, height = options.parse_size(size)
    parts = {} if camera is None else options.parse_camera(camera)
    animated = is_animation(output, frames)
    if not animated:
        options.check_output(output, (".png", ".exr"), inputs=[scene, str(environment or scene)])
    chosen = tracer_options(
        option or [],
        device,
        adapter=adapter,
        gpu=gpu,
        traversal=traversal,
        machine=machine,
        scheduler=scheduler,
    )
    resume_given = (resume or None) if not animated else None
    sampling = SamplingOptions(samples, seed, max_bounces, noise, time_limit, sampler, resume_given)
    wanted = LayerSelection.of(output, layers, denoise)
    check_environment(environment, environment_rotation)
    image_only = {
        **{"mode": mode, "exposure": exposure, "tone": tone, "environment": environment},
        **{"lights": lights, "layers": layers, "denoise": denoise or None, "cluster": cluster},
        **sampling.for_images(),
    }
    check_heatmap(heatmap, maximum, image_only, chosen)
    mode = mode or options.MODES[0]
    check_cluster(cluster, threads)
    choose_threads(threads)
    from raystream.rendering.arguments import MAX_PIXELS
    from raystream.rendering.heatmap import heatmap as draw_heatmap

    if width * height > MAX_PIXELS:
        raise BadInputError(f"--size: at most {MAX_PIXELS:,} pixels, got {width}x{height}")
    arguments: dict[str, Any] = {"samples": samples or 1, "seed": seed}
    if heatmap is None:
        arguments = mode_arguments(mode, sampling, chosen)
        arguments["lights"] = lights or options.LIGHTS[0]
    if animated:
        arguments["layers"] = wanted.rendered
        refuse_beside_frames({"heatmap": heatmap, "maximum": maximum, "time": time})
        animation = AnimationOptions(
            scene,
            output,
            frames,
            fps,
            resume,
            mode,
            (width, height),
            parts,
            exposure or 1.0,
            tone or options.TONES[0],
            arguments,
            structure or next(iter(options.STRUCTURES)),
            device,
            chosen,
            triangles,
            environment,
            environment_rotation or 0.0,
            wanted if denoise else None,
            cluster,
            threads,
        )
        render_animation(animation, json)
        return
    if fps is not None:
        raise BadInputError("--fps: only with --frames")
    which = parts.pop("which", None)
    checkpoint = checkpoint_path(output, resume) if heatmap is None else None
    save = _saver(output, exposure or 1.0, tone or options.TONES[0])
    watch = Stopwatch()
    heat: Heatmap | None = None
    with (
        Bars() as bars,
        compiling(f"render-{mode}", structure, device, watch),
        cluster_client(cluster, threads) as client,
        sample_checkpoint(checkpoint) as samples_file,
    ):
        render_with = ImageRenderer(client, structure, device, chosen)
        source = Source(scene, structure, device, time, triangles, chosen)
        if render_with.builds_on_workers:
            source = Source(scene, None, "cpu", time, triangles)
        tracer = open_tracer(source, bars, watch)
        if environment is not None:
            with watch.measure("environment"), bars.step("reading environment"):
                tracer.update(
                    with_environment(tracer.scene, environment, environment_rotation or 0.0)
                )
        view = tracer.scene.camera_for(width / height)
        with refuse(ValueError, where="--camera"):
            if which is not None:
                view = tracer.scene.replace(camera=which).camera
            view = dataclasses.replace(view, **parts)
        arguments |= {"size": (width, height), "camera": view}
        unit = "paths" if heatmap is None else "rays"
        with watch.measure("trace"), bars.step("rendering", unit) as progress:
            if heatmap is None:
                report_added_light(tracer.scene, mode, arguments["lights"])
                paths = PathProgress(output, width * height, progress)
                arguments |= {"checkpoint": samples_file, "on_pass": save}
                arguments["layers"] = wanted.rendered
                with refuse(OSError, where=str(checkpoint)):
                    image = render_with(tracer, mode, progress=paths, **arguments)
            else:
                heat = draw_heatmap(
                    tracer, heatmap, maximum=maximum, progress=progress, **arguments
                )
                image = heat.image
        if denoise:
            with watch.measure("denoise"), bars.step("denoising"):
                image = wanted.denoised(image)
        with watch.measure("save"), bars.step("saving"):
            save(image)
    triangle_count = len(tracer.structure.triangles)
    if heat is None:
        ray_count, counts, figures = paths.count(image), paths.text(image), paths.figures(image)
    else:
        ray_count = width * height * arguments["samples"]
        counts, figures = heat.title, heatmap_figures(heat)
    speed = rays_per_second(ray_count, watch.seconds["trace"])
    if json:
        write_json(
            {
                "output": str(output),
                "scene": scene,
                **({"mode": mode} if heat is None else {}),
                **figures,
                "width": width,
                "height": height,
                "samples": arguments["samples"],
                "structure": render_with.structure_name(tracer),
                **machine_figures(chosen, device),
                "triangles": triangle_count,
                "rays": ray_count,
                "seconds": watch.rounded(),
                "mrays_per_second": speed,
            }
        )
    else:
        write_line(
            f"{one_line(str(output))}: {width}x{height}, {triangle_count:,} triangles; {counts}; "
            f"{watch.text()}; {speed:g} M{unit}/s"
        )


def _saver(output: Path, exposure: float, tone: str) -> Callable[[Image], None]:
    def save(image: Image) -> None:
        with refuse(OSError, where=str(output)):
            image.save(output, exposure=exposure, tone=tone)

    return save
