"""export_page: a scene as a page that traces rays on the visitor's GPU."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from dataclasses import replace
from importlib.resources import files
from os import PathLike

import numpy as np

from raystream.core.errors import RaystreamWarning
from raystream.graphics.rendering.modes import TEXTURES
from raystream.rendering.arguments import check_camera, check_size, check_switch
from raystream.rendering.render import render
from raystream.scene.camera import Camera
from raystream.scene.io.colors import byte_colors_to_linear
from raystream.scene.material import Material
from raystream.scene.scene import Scene
from raystream.structures import StructureOptions, options_of
from raystream.tracer import Tracer
from raystream.web.pack import packed_bytes
from raystream.web.page_parts import PageParts, write_file, write_folder
from raystream.web.scene_data import check_supported, page_scene
from raystream.web.structure_names import structure_names

#: Modules of the page, each after those that it imports.
MODULES = (
    "vector.js",
    "view.js",
    "elements.js",
    "gestures.js",
    "pack.js",
    "page_data.js",
    "geometry.js",
    "shaders.js",
    "webgpu.js",
    "device.js",
    "queries.js",
    "boxes.js",
    "view_uniform.js",
    "walk.js",
    "walk_panel.js",
    "scene_on_gpu.js",
    "gpu_clock.js",
    "images.js",
    "pass_streams.js",
    "pass_schedule.js",
    "passes.js",
    "pass_panel.js",
    "display.js",
    "address.js",
    "traced_image.js",
    "counts.js",
    "heatmaps.js",
    "exported.js",
)

STYLES = ("theme.css", "exported.css")

#: Width over height of an image whose whole height the camera's field of view is: wider ones show
#: more at the sides, others more above and below; see ``view.js``.
PAGE_ASPECT = 4 / 3

#: Imports of other modules; and what is before exported names.
_IMPORT = re.compile(r'^import (\{[^}]*\}) from "\./([a-z_]+\.js)";\n', re.MULTILINE)
_EXPORT = re.compile(r"^export (?=(?:async )?(?:const|function|class) (\w+))", re.MULTILINE)


def export_page(
    scene: Scene | Tracer,
    path: str | PathLike[str],
    *,
    structures: Sequence[str | StructureOptions] | None = None,
    camera: Camera | None = None,
    size: tuple[int, int] = (960, 540),
    split: bool = False,
) -> int:
    """Write a scene as a page that traces it on the visitor's GPU, by WebGPU.

    The page is one file, which opens from disk or any server and needs no network; or a folder of
    files for a server. It contains the scene's triangles, materials and lights, the structures as
    built here, and the shaders of ``device="graphics"``. Without WebGPU, it shows an image that
    was rendered here.

    Parameters
    ----------
    scene : Scene or Tracer
    path : path
        Path of the page, such as ``"page.html"``; with `split`, of a folder, whose files are
        replaced.
    structures : sequence of str or StructureOptions
        The structures to choose from; the first one is selected initially [default: ``["bvh"]``].
        Several may be of one kind with different options, such as the traversals of a kd-tree:
        equal arrays are stored once. Not allowed with a tracer, which has its own.
    camera : Camera, optional
        The initial view [default: the scene's camera, or one chosen by `Scene.camera_for`].
    size : (int, int)
        Size of the image for visitors without WebGPU.
    split : bool
        Write a folder with ``index.html``, its script, style, image and data, for large scenes: it
        takes three quarters of the bytes, and browsers cache files that have not changed. Browsers
        open it from a server only.

    Returns
    -------
    int
        Bytes written.

    Raises
    ------
    RaystreamError
        If the shaders do not support the scene, or a structure.
    ValueError, TypeError
        If an argument is wrong.
    OSError
        If a file cannot be written.

    Warns
    -----
    RaystreamWarning
        If textures other than diffuse ones were left out, which the shaders do not support; with a
        tracer, they are an error.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> import raystream as rs
    >>> page = pathlib.Path(tempfile.mkdtemp()) / "cornell.html"
    >>> rs.export_page(rs.load("cornell"), page) < 500_000
    True
    """
    width, height = check_size(size)
    check_camera(camera)
    check_switch("split", split)
    if isinstance(scene, Tracer):
        if structures is not None:
            raise ValueError("structures: a tracer has its own; pass its scene to choose others")
        check_supported(scene, camera or scene.scene.camera_for(PAGE_ASPECT))
        tracers = [scene]
    else:
        wanted = _checked(structures)
        if not isinstance(scene, Scene):
            raise TypeError(
                f"scene: expected a Scene or Tracer, got {type(scene).__name__}; see rs.load"
            )
        scene = _with_known_textures(scene)
        view = camera or scene.camera_for(PAGE_ASPECT)
        check_supported(Tracer(scene, "brute"), view)
        tracers = [Tracer(scene, one) for one in wanted]
    found = tracers[0].scene
    made = page_scene(tracers, camera or found.camera_for(PAGE_ASPECT))
    seen = camera or found.camera_for(width / height)
    image = render(tracers[0], "raycast", (width, height), samples=4, camera=seen)
    parts = PageParts(
        title=found.name or "raystream",
        template=_text("exported.html"),
        style="\n".join(map(_text, STYLES)),
        script=_script(),
        image=image.to_png(),
        data=packed_bytes(made.manifest, made.arrays),
    )
    return write_folder(path, parts) if split else write_file(path, parts)


def _checked(
    structures: Sequence[str | StructureOptions] | None,
) -> Sequence[StructureOptions]:
    if structures is None:
        return [options_of("bvh")]
    if isinstance(structures, (str, StructureOptions)):
        raise TypeError(f"structures: expected a list, such as [{structures!r}]")
    if not structures:
        raise ValueError("structures: expected at least one")
    wanted = [options_of(one) for one in structures]
    structure_names(wanted)
    return wanted


def _with_known_textures(scene: Scene) -> Scene:
    """The scene without the textures that shaders do not have."""
    left_out = sorted({name for one in scene.materials for name in one.textures} - TEXTURES)
    if not left_out:
        return scene
    warnings.warn(
        f"export: pages have diffuse textures only; left out those of {', '.join(left_out)}",
        RaystreamWarning,
        stacklevel=3,
    )
    return scene.replace(materials=[_with_known(one) for one in scene.materials])


def _with_known(material: Material) -> Material:
    """What glows by a texture that is left out has its mean."""
    kept = {role: one for role, one in material.textures.items() if role in TEXTURES}
    if len(kept) == len(material.textures):
        return material
    red, green, blue = material.emission
    if (texture := material.textures.get("emission")) is not None:
        means = byte_colors_to_linear(texture.pixels()[..., :3]).mean(axis=(0, 1), dtype=np.float64)
        red, green, blue = (float(one) for one in means * material.emission)
    return replace(material, textures=kept, emission=(red, green, blue))


def _script() -> str:
    """The modules as one script: each is a function that returns what it exports."""
    return "\nconst modules = {};\n" + "\n".join(map(_module, MODULES))


def _module(name: str) -> str:
    text = _IMPORT.sub(r'const \1 = modules["\2"];\n', _text(name))
    names = ", ".join(_EXPORT.findall(text))
    return f'modules["{name}"] = (() => {{\n{_EXPORT.sub(r"", text)}return {{{names}}};\n}})();'


def _text(name: str) -> str:
    """A file of the page, or one that the viewer has, too."""
    room = files("raystream.web")
    folder = next(one for one in ("page", "shared") if (room / one / name).is_file())
    return (room / folder / name).read_text(encoding="utf-8")
