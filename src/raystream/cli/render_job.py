"""Options of ``raystream render``, and the arguments of the library that they stand for."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from raystream.cli import options
from raystream.cli.clusters import ClusterOptions
from raystream.cli.console import BadInputError, refuse
from raystream.cli.frame_files import IMAGES, AnimationOptions
from raystream.cli.heatmaps import HeatmapOptions
from raystream.cli.layers import LayerOptions, LayerSelection
from raystream.cli.lighting import LightingOptions
from raystream.cli.load import choose_threads
from raystream.cli.option_groups import options_given
from raystream.cli.sampling import SamplingOptions, mode_arguments
from raystream.cli.tracer_options import TracerArguments, TracerOptions

if TYPE_CHECKING:
    from raystream.rendering.image import Image
    from raystream.scene.camera import Camera
    from raystream.scene.scene import Scene

__all__ = ["ImageOptions", "RenderJob"]


@dataclass(frozen=True, kw_only=True)
class ImageOptions:
    """Options of an image or of the frames of an animation."""

    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="Output file: .png, .exr or .hdr; frames and videos with --frames.",
        ),
    ] = Path("out.png")
    mode: Annotated[
        str | None,
        options.choice(
            options.MODES,
            f"Renderer: {' or '.join(options.MODES)} [default: {options.MODES[0]}]",
        ),
    ] = None
    heat: HeatmapOptions
    animation: AnimationOptions
    size: Annotated[str, typer.Option(metavar="WIDTHxHEIGHT", help="Size in pixels.")] = "1024x768"
    sampling: SamplingOptions
    resume: Annotated[
        bool,
        typer.Option(
            "--resume", help="Resume from the checkpoint beside the image, if there is one."
        ),
    ] = False
    camera: Annotated[
        str | None,
        typer.Option(
            metavar="PARTS",
            help="One of the scene's cameras by name or number (from 0), followed by the "
            "parameters to override, as in 'eye=3,2,1 look_at=0,0,0 up=0,1,0 fov=40' (vertical "
            "field of view in degrees); also projection=orthographic height=3 (or "
            "equirectangular), or a thin lens: aperture=0.1 focus=5.",
        ),
    ] = None
    exposure: Annotated[
        float | None,
        typer.Option(
            metavar="FACTOR",
            callback=options.positive,
            help="Exposure factor for PNG output [default: 1]",
        ),
    ] = None
    tone: Annotated[
        str | None,
        options.choice(
            options.TONES,
            "Tone curve for PNG output, applied after the exposure: "
            f"{' or '.join(options.TONES)} [default: {options.TONES[0]}]",
        ),
    ] = None
    lighting: LightingOptions
    layers: LayerOptions

    @property
    def is_animation(self) -> bool:
        """Whether an animation is requested."""
        return self.animation.is_animation(self.output)

    def save(self, image: Image, path: Path) -> None:
        """Write an image to a file."""
        with refuse(OSError, where=str(path)):
            image.save(path, exposure=self.exposure or 1.0, tone=self.tone or options.TONES[0])


@dataclass(frozen=True)
class RenderJob:
    """A checked ``raystream render``.

    Attributes
    ----------
    scene : str
    image : ImageOptions
    loading : SceneOptions
    workers : ClusterOptions
    chosen : TracerArguments
    mode : str
    size : (int, int)
    camera : dict
        Camera parameters, and ``which`` of the scene's cameras.
    layers : LayerSelection
    arguments : dict
        Arguments of `raystream.render` or `raystream.heatmap` that do not depend on the scene.
    """

    scene: str
    image: ImageOptions
    loading: options.SceneOptions
    workers: ClusterOptions
    chosen: TracerArguments
    mode: str
    size: tuple[int, int]
    camera: dict[str, Any]
    layers: LayerSelection
    arguments: dict[str, Any]

    @classmethod
    def of(
        cls,
        scene: str,
        image: ImageOptions,
        tracing: TracerOptions,
        workers: ClusterOptions,
        loading: options.SceneOptions,
    ) -> RenderJob:
        """Check the options of a command, and set the number of threads.

        Raises
        ------
        BadInputError
            If options are invalid or contradict each other.
        """
        size = width, height = options.parse_size(image.size)
        camera = {} if image.camera is None else options.parse_camera(image.camera)
        if not image.is_animation:
            inputs = [scene, str(image.lighting.environment or scene)]
            options.check_output(image.output, IMAGES, inputs)
        chosen = tracing.arguments()
        layers = image.layers.select(image.output)
        image.lighting.check()
        if image.is_animation:
            _refuse_beside_frames(options_given(image.heat) | {"time": loading.time})
        image.heat.check(options_given(image) | options_given(workers), chosen)
        workers.check()
        choose_threads(workers.threads)
        from raystream.rendering.arguments import MAX_PIXELS

        if width * height > MAX_PIXELS:
            raise BadInputError(f"--size: at most {MAX_PIXELS:,} pixels, got {width}x{height}")
        mode = image.mode or options.MODES[0]
        if image.heat.heatmap is not None:
            sampling = image.sampling
            arguments: dict[str, Any] = {"samples": sampling.samples or 1, "seed": sampling.seed}
        else:
            arguments = mode_arguments(mode, image.sampling, chosen.options)
            arguments["lights"] = image.lighting.lights or options.LIGHTS[0]
            arguments["layers"] = layers.rendered
        return cls(scene, image, loading, workers, chosen, mode, size, camera, layers, arguments)

    def view(self, scene: Scene) -> tuple[Scene, Camera]:
        """Return a scene with the chosen one of its cameras, and that camera as changed."""
        parts = dict(self.camera)
        which = parts.pop("which", None)
        with refuse(ValueError, where="--camera"):
            if which is not None:
                scene = scene.replace(camera=which)
            width, height = self.size
            return scene, dataclasses.replace(scene.camera_for(width / height), **parts)


def _refuse_beside_frames(given: dict[str, Any]) -> None:
    for name, value in given.items():
        if value:
            raise BadInputError(f"--{name}: cannot be combined with --frames")
