"""Options of ``raystream render``, and the arguments of the library that they stand for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from raystream.cli import options
from raystream.cli.brightness import Exposure, parse_exposure
from raystream.cli.camera_options import CameraOptions
from raystream.cli.clusters import ClusterOptions
from raystream.cli.console import BadInputError, refuse, write_bytes
from raystream.cli.frame_files import IMAGES, AnimationOptions, FrameFiles
from raystream.cli.heatmaps import HeatmapOptions
from raystream.cli.layers import LayerOptions, LayerSelection
from raystream.cli.lighting import LightingOptions
from raystream.cli.load import choose_threads
from raystream.cli.option_groups import options_given
from raystream.cli.sampling import (
    SamplingOptions,
    is_denoised,
    is_preview,
    mode_arguments,
    tells_error,
)
from raystream.cli.tracer_options import TracerArguments, TracerOptions

if TYPE_CHECKING:
    from raystream.rendering.image import Image
    from raystream.scene.camera import Camera
    from raystream.scene.scene import Scene

#: As ``--output``: a PNG on stdout.
STDOUT = Path("-")


@dataclass(frozen=True, kw_only=True)
class ImageOptions:
    """Options of an image or of the frames of an animation."""

    output: Annotated[
        Path | None,
        options.output(
            "Output file: .png, .exr or .hdr, or - for a PNG on stdout; frames and videos "
            "with --frames. [default: SCENE.png]"
        ),
    ] = None
    force: Annotated[
        bool, options.flag("--force", "Replace an output file that raystream did not write.")
    ] = False
    mode: Annotated[
        str | None,
        options.choice(
            options.MODES,
            f"Renderer: {' or '.join(options.MODES)} [default: {options.DEFAULT_MODE}]. Rays of ao "
            "are a tenth of the scene's diagonal long, or --option distance=LENGTH.",
        ),
    ] = None
    heat: HeatmapOptions
    animation: AnimationOptions
    size: Annotated[str, options.value("WIDTHxHEIGHT", "Size in pixels.")] = "1024x768"
    sampling: SamplingOptions
    resume: Annotated[
        bool,
        options.flag("--resume", "Resume from the checkpoint next to the image, if there is one."),
    ] = False
    view: CameraOptions
    exposure: Annotated[
        str | None,
        typer.Option(
            metavar="FACTOR",
            callback=parse_exposure,
            help="Factor on the colours of a PNG, or auto [default: 1; auto with --sun, without "
            "lights, and for dark images]",
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

    def save(self, image: Image, path: Path, exposure: Exposure) -> None:
        """Write an image to a file, or to stdout for ``-``."""
        tone = self.tone or options.TONES[0]
        look: dict[str, Any] = {"exposure": exposure.of(image), "tone": tone}
        if path == STDOUT:
            write_bytes(image.to_png(**look))
            return
        with refuse(OSError, where=str(path)):
            image.save(path, **look)


@dataclass(frozen=True)
class RenderJob:
    """A checked ``raystream render``.

    Attributes
    ----------
    scene : str
    image : ImageOptions
    output : Path
    loading : SceneOptions
    workers : ClusterOptions
    chosen : TracerArguments
    mode : str
    size : (int, int)
    layers : LayerSelection
    arguments : dict
        Arguments of `raystream.render` or `raystream.heatmap` that do not depend on the scene.
    """

    scene: str
    image: ImageOptions
    output: Path
    loading: options.SceneOptions
    workers: ClusterOptions
    chosen: TracerArguments
    mode: str
    size: tuple[int, int]
    layers: LayerSelection
    arguments: dict[str, Any]

    @property
    def tells_error(self) -> bool:
        """Whether the image's error is told; see `sampling.tells_error`."""
        return tells_error(self.mode, self.image.sampling)

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
        output = image.output or _default_output(scene)
        if output != STDOUT:
            if image.is_animation:
                is_one = isinstance(image.animation.parse_frames(), int)
                FrameFiles.of(output, scene, is_one)  # --force does not mend a wrong name
            else:
                inputs = [scene, str(image.lighting.environment or scene)]
                options.check_output(output, IMAGES, inputs)
            options.check_replaced(output, image.force)
        chosen = tracing.arguments()
        mode = image.mode or options.DEFAULT_MODE
        is_image = image.heat.heatmap is None
        layers = image.layers.select(
            output, is_image and is_denoised(mode, image.sampling), is_preview(image.sampling)
        )
        image.lighting.check()
        if image.is_animation:
            _refuse_beside_frames(options_given(image.heat) | {"time": loading.time})
        image.heat.check(options_given(image) | options_given(workers), chosen)
        workers.check()
        choose_threads(workers.threads)
        from raystream.rendering.arguments import MAX_PIXELS

        if width * height > MAX_PIXELS:
            raise BadInputError(f"--size: at most {MAX_PIXELS:,} pixels, got {width}x{height}")
        if not is_image:
            sampling = image.sampling
            arguments: dict[str, Any] = {"samples": sampling.samples or 1, "seed": sampling.seed}
        else:
            arguments = mode_arguments(mode, image.sampling, chosen.options)
            arguments["lights"] = image.lighting.lights or options.LIGHTS[0]
            arguments["layers"] = layers.rendered
        return cls(scene, image, output, loading, workers, chosen, mode, size, layers, arguments)

    def view(self, scene: Scene) -> tuple[Scene, Camera]:
        """Return a scene with the chosen one of its cameras, and that camera as changed."""
        width, height = self.size
        return self.image.view.of(scene, width / height)


def _default_output(scene: str) -> Path:
    """The name of a scene with ``.png``: of ``city:1000`` and ``a/city.obj.gz``, ``city.png``."""
    name = Path(scene).name.partition(":")[0].removesuffix(".gz")
    return Path(f"{Path(name).stem or 'image'}.png")


def _refuse_beside_frames(given: dict[str, Any]) -> None:
    for name, value in given.items():
        if value:
            raise BadInputError(f"--{name}: cannot be combined with --frames")
