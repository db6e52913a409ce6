"""Brightness on the command line: the exposure of images, and notes on black and white ones."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import typer

from raystream.cli.console import write_note

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from raystream.cli.lighting import LightingOptions
    from raystream.rendering.image import Image
    from raystream.scene.camera import Camera
    from raystream.scene.scene import Scene
    from raystream.tracer import Tracer

#: Share of the pixels that are black, or white, in an image that is reported; and the bytes that
#: count as such.
_MOST, _BLACK, _WHITE = 0.99, 2, 253

#: Images of scenes with lights are dark if this share of their pixels is below this luminance: a
#: fifth of a screen's range, encoded.
_DARK_SHARE, _DARK = 0.9, 0.03

#: Modes that show light; a test compares them with the library's.
LIT = ("raycast", "shadow", "whitted", "kajiya", "path")


def parse_exposure(text: str | None) -> str | None:
    """Accept ``auto`` or a number above 0; a callback of Typer."""
    if text is None or text == "auto":
        return text
    try:
        factor = float(text)
    except ValueError:
        factor = math.nan
    if not (math.isfinite(factor) and factor > 0.0):
        raise typer.BadParameter(f"expected 'auto' or a number above 0, got {text!r:.40}")
    return text


class Exposure:
    """The exposure factor of images.

    Parameters
    ----------
    asked : str or None
        ``"auto"``, a number, or None: automatic for single images with a sun, of scenes without
        lights, and those that would be dark; else 1, also with ``--lights file``.
    lighting : LightingOptions
    scene : Scene
    mode : str
        Modes that show no light are exposed by 1, unless a factor is asked for.
    is_fixed : bool
        Whether all images get the factor of the first one, as frames do.
    """

    def __init__(
        self,
        asked: str | None,
        lighting: LightingOptions,
        scene: Scene,
        mode: str,
        *,
        is_fixed: bool = False,
    ) -> None:
        from raystream.rendering.lighting import is_dark_by_intent

        is_lit = scene.has_lights and lighting.sun is None
        self._is_for_dark_images = asked is None and is_lit
        if asked is None:
            keeps = is_fixed or mode not in LIT or lighting.lights == "file"
            keeps = keeps or (is_lit and is_dark_by_intent(scene))
            asked = "1" if keeps else "auto"
        self._asked = asked
        self._is_fixed = is_fixed

    def of(self, image: Image) -> float:
        """The factor for an image."""
        if self._asked != "auto":
            return float(self._asked)
        from raystream.rendering.tone import auto_exposure

        factor = auto_exposure(image.pixels)
        if self._is_for_dark_images:
            factor = max(factor, 1.0) if _is_dark(image) else 1.0
        if self._is_fixed:
            self._asked = repr(factor)
        return factor

    def text(self, image: Image) -> str:
        """The factor for the console, if it is not 1."""
        factor = self.of(image)
        return "" if factor == 1.0 else f", exposure {factor:.3g}"

    def report_dark(self, image: Image) -> None:
        """Report on stderr that an image of a scene with lights is shown brighter than it is."""
        factor = self.of(image)
        if self._is_for_dark_images and factor != 1.0:
            write_note(
                f"the scene's lights leave the image dark: it is shown {factor:.3g} times as "
                "bright (--exposure 1 leaves it dark)"
            )


def _is_dark(image: Image) -> bool:
    import numpy as np

    from raystream.rendering.color import luminance

    brightness = np.nan_to_num(luminance(image.pixels))
    return float(np.quantile(brightness, _DARK_SHARE)) < _DARK


def report_blank(
    encoded: NDArray[np.uint8], tracer: Tracer, camera: Camera, chosen: dict[str, Any], mode: str
) -> None:
    """Report an image that is black, white or of no surface on stderr, with what mends it.

    Parameters
    ----------
    encoded : ndarray of shape (H, W, 3), uint8
    tracer : Tracer
    camera : Camera
    chosen : dict
        Arguments of `raystream.render`.
    mode : str
    """
    from raystream.rendering.view_light import sees_surface

    height, width, _ = encoded.shape
    if tracer.scene.triangle_count and not sees_surface(tracer, camera, (width, height)):
        write_note("the camera sees no surface: --eye and --look-at move it")
        return
    is_black = float((encoded.max(axis=2) <= _BLACK).mean()) > _MOST
    is_white = float((encoded.min(axis=2) >= _WHITE).mean()) > _MOST
    if mode == "ao":  # black where no surface is
        is_black = not encoded.any()
    if not (is_black or is_white) or mode in ("vis", "xray"):
        return
    if mode == "ao":
        why = "--option distance=LENGTH changes how far away surfaces occlude"
    elif is_white:
        why = "it is overexposed; --exposure auto shows more"
    elif chosen.get("lights") == "file" and not tracer.scene.has_lights:
        why = "the scene has no lights; --lights auto adds some"
    elif chosen.get("lights") == "file":
        why = "the scene's own lights do not reach what the camera sees; --lights auto adds others"
    else:
        why = "there is too little light; --exposure auto shows more, --lights added adds some"
    write_note(f"the image is {'black' if is_black else 'white'}: {why}")
