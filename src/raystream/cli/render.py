"""``raystream render``: render an image or an animation of a scene."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from raystream.cli import options
from raystream.cli.animations import render_animation
from raystream.cli.bars import Bars
from raystream.cli.brightness import Exposure, report_blank
from raystream.cli.checkpoint import PathProgress, checkpoint_path, sample_checkpoint
from raystream.cli.clusters import ClusterOptions, ImageRenderer
from raystream.cli.compiling import compiling, render_task
from raystream.cli.console import (
    BadInputError,
    one_line,
    refuse,
    write_json,
    write_line,
    write_note,
)
from raystream.cli.heatmaps import heatmap_figures
from raystream.cli.load import (
    Stopwatch,
    open_tracer,
    rays_per_second,
    triangle_figures,
    triangle_text,
)
from raystream.cli.option_groups import expand_groups
from raystream.cli.render_job import STDOUT, ImageOptions, RenderJob
from raystream.cli.tracer_options import TracerArguments, TracerOptions

if TYPE_CHECKING:
    from raystream.rendering.heatmap import Heatmap
    from raystream.rendering.image import Image
    from raystream.scene.scene import Scene

DEFAULT_SCENE = "robots"

#: Files that keep radiance.
UNEXPOSED = (".exr", ".hdr")


@expand_groups
def render(
    scene: options.SceneName = DEFAULT_SCENE,
    *,
    image: ImageOptions,
    tracing: TracerOptions,
    workers: ClusterOptions,
    loading: options.SceneOptions,
    json: options.Json = False,
) -> None:
    """Render an image of a scene. Without SCENE, renders robots in a city."""
    if json and image.output == STDOUT:
        raise BadInputError("--json: cannot be combined with --output -")
    job = RenderJob.of(scene, image, tracing, workers, loading)
    if image.is_animation:
        render_animation(job, json)
    elif image.animation.fps is not None:
        raise BadInputError("--fps: only with --frames")
    else:
        _render_image(job, json)


def _render_image(job: RenderJob, json: bool) -> None:
    """Render one image or heat map, and print its figures."""
    asked, output, (width, height) = job.image, job.output, job.size
    what = asked.heat.heatmap
    has_file = what is None and output != STDOUT
    checkpoint = checkpoint_path(output, asked.resume) if has_file else None
    watch = Stopwatch()
    heat: Heatmap | None = None
    with (
        Bars() as bars,
        compiling(f"render-{job.mode}", job.chosen, watch) as kernels,
        job.workers.client() as client,
        sample_checkpoint(checkpoint) as samples_file,
    ):
        render_with = ImageRenderer(client, job.chosen)
        built = job.chosen
        if render_with.builds_on_workers:
            built = TracerArguments(None, "cpu", {})

        def choose_task(scene: Scene) -> None:
            if what is None:
                kernels.task = render_task(job.mode, scene, asked.lighting.has_sky)

        tracer = open_tracer(job.scene, job.loading, built, bars, watch, choose_task)
        if asked.lighting.has_sky:
            with watch.measure("environment"), bars.step("preparing the sky"):
                tracer.update(asked.lighting.apply(tracer.scene))
        arguments = {**job.arguments, "size": job.size, "camera": job.view(tracer.scene)[1]}
        exposure = Exposure(
            asked.exposure, asked.lighting, tracer.scene, job.mode if what is None else what
        )
        save = partial(asked.save, exposure=exposure)
        unit = "paths" if what is None else "rays"
        with watch.measure("trace"), bars.step("rendering", unit) as progress:
            if what is None:
                paths = PathProgress(output, width * height, progress, job.tells_error)
                arguments |= {"checkpoint": samples_file, "progress": paths}

                def show_pass(image: Image, paths: PathProgress = paths) -> None:
                    paths.show_error(image)
                    if output != STDOUT:
                        save(image, path=output)

                with refuse(OSError, where=str(checkpoint)):
                    image = render_with(tracer, job.mode, on_pass=show_pass, **arguments)
            else:
                from raystream.rendering.heatmap import heatmap

                maximum = asked.heat.maximum
                heat = heatmap(tracer, what, maximum=maximum, progress=progress, **arguments)
                image = heat.image
        if job.layers.is_denoised:
            job.layers.report_denoiser()
            with watch.measure("denoise"), bars.step("denoising"):
                image = job.layers.denoise(image)
        with watch.measure("save"), bars.step("saving"):
            save(image, path=output)
        if what is None:
            look = exposure.of(image), asked.tone or options.TONES[0]
            if output.suffix.lower() not in UNEXPOSED:
                exposure.report_dark(image)
            report_blank(image.to_bytes(*look), tracer, arguments["camera"], arguments, job.mode)
    if heat is None:
        ray_count, counts, figures = paths.count(image), paths.text(image), paths.figures(image)
        if output.suffix.lower() not in UNEXPOSED:
            counts += exposure.text(image)
            figures["exposure"] = exposure.of(image)
    else:
        ray_count = width * height * arguments["samples"]
        counts, figures = heat.title, heatmap_figures(heat)
    speed = rays_per_second(ray_count, watch.seconds["trace"])
    write = write_note if output == STDOUT else write_line
    if json:
        write_json(
            {
                "output": str(output),
                "scene": job.scene,
                **({"mode": job.mode} if heat is None else {}),
                **figures,
                "width": width,
                "height": height,
                "samples": arguments["samples"],
                "structure": render_with.structure_name(tracer),
                **job.chosen.figures(),
                **triangle_figures(tracer.scene),
                "rays": ray_count,
                "seconds": watch.rounded(),
                "mrays_per_second": speed,
            }
        )
    else:
        write(
            f"{one_line(str(output))}: {width}x{height}, {triangle_text(tracer.scene)}; "
            f"{counts}; {watch.text()}; {speed:g} M{unit}/s"
        )
