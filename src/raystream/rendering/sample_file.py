"""SampleFile: an image's checkpoint file, and the identity of the image that it belongs to."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict
from functools import cache
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np

from raystream._version import __version__
from raystream.core.errors import FileFormatError
from raystream.rendering.environment import image_light, texels_of
from raystream.rendering.film import Film
from raystream.rendering.integrator import Integrator, RenderContext
from raystream.rendering.lighting import HEADLIGHT, SKY, SUN
from raystream.rendering.sampling.sampler import Sampler
from raystream.scene.scene import Scene


class SampleFile(PathLike[str]):
    """An image's checkpoint, which `render` takes in place of a path.

    The image's identity is a digest of the whole scene. It is computed only when the file is
    first read or written.

    Parameters
    ----------
    path : str or path
        Ends in ``.npz``.
    at_end : bool
        Write the samples of every complete image. If False, those of an image that is complete
        before a checkpoint is due are held, for `save_held`.
    """

    def __init__(self, path: str | PathLike[str], at_end: bool = True) -> None:
        self._path = fspath(path)
        self._at_end = at_end
        self._identity: Callable[[], str] | None = None
        self._held: Film | None = None

    def __fspath__(self) -> str:
        return self._path

    def open(self, renderer: Integrator, context: RenderContext) -> Film | None:
        """Begin an image: return the film of an existing checkpoint, or None.

        Raises
        ------
        FileFormatError
            If the file is corrupt, of another image, or has unequal numbers of samples, as files
            of earlier versions may.
        """
        self._identity = cache(lambda: identity(renderer, context))
        if not Path(self._path).exists():
            return None
        film = Film.load(self._path, self._identity())
        is_whole = (film.width, film.height) == (context.width, context.height)
        if not is_whole or film.counts.min() < film.counts.max():
            reason = "does not hold the same number of samples for every pixel of the image"
            raise FileFormatError(self._path, reason)
        return film

    def save(self, sums: Film) -> None:
        """Write a film; raises OSError on failure."""
        assert self._identity is not None, "open comes first"
        sums.save(self._path, self._identity())

    def finish(self, sums: Film, is_due: bool) -> None:
        """Save or hold the film of a complete image.

        Parameters
        ----------
        sums : Film
        is_due : bool
            Whether a checkpoint is due.
        """
        if self._at_end or is_due or Path(self._path).exists():
            self.save(sums)
        else:
            self._held = sums

    def save_held(self) -> None:
        """Write the film that `finish` held, if any, for example if saving the image failed."""
        if self._held is not None:
            self.save(self._held)


def identity(renderer: Integrator, context: RenderContext) -> str:
    """Everything that samples depend on, as JSON: images with equal ones can be resumed."""
    sampler = context.sampler
    # A single sample goes through the pixels' centres. Unless samples depend on their number, an
    # image may get more of them later.
    depends = sampler == Sampler.of("stratified", sampler.seed, sampler.sample_count)
    counts = sampler.sample_count if depends else min(sampler.sample_count, 2)
    precision = context.tracer.structure.precision
    return json.dumps(
        {
            "raystream": __version__,
            "mode": renderer.name,
            "options": {name: str(value) for name, value in context.options.items()},
            "size": [context.width, context.height],
            "sampler": [sampler.kind, sampler.seed, counts],
            "camera": str(asdict(context.camera)),
            "layers": list(context.layers),
            "lights": context.chosen_lights,
            "added lights": [SKY, SUN, HEADLIGHT] if context.is_light_added else [],
            "scene": _digest(context.tracer.scene),
            **({"precision": precision} if precision != "float32" else {}),
        },
        sort_keys=True,
    )


def _digest(scene: Scene) -> str:
    """A hash of everything in a scene that affects images."""
    digest = hashlib.sha256()

    def add(value: Any) -> None:
        if isinstance(value, np.ndarray):
            digest.update(f"{value.dtype}{value.shape}".encode())
            digest.update(np.ascontiguousarray(value).view(np.uint8).data)
        else:
            digest.update(repr(value).encode())

    triangles: Any = scene.triangles
    add(triangles.object_corners())
    if triangles.instances is not None:
        add(triangles.instances.object_ids)
        add(triangles.instances.transforms)
    if triangles.has_primitives:
        for array in vars(triangles.spheres).values():
            add(array)
        for shapes in triangles.shapes:
            for part in (shapes.records, shapes.material_ids, shapes.functions.identity()):
                add(part)
        for field in triangles.fields:
            for part in (field.heights, field.x, field.y, (field.base, field.material_id)):
                add(part)
    add((scene.triangles.center.tolist(), float(scene.triangles.scale)))
    for mesh in scene.meshes:
        for array in (mesh.normals, mesh.texcoords, mesh.colors, mesh.material_ids):
            add(array)
    for material in scene.materials:
        plain = {**vars(material), "textures": sorted(material.textures)}
        add(plain)
        for _, texture in sorted(material.textures.items()):
            add(texture.wrap)
            if texture.transform is not None:
                add(texture.transform)
            try:
                add(texture.pixels())
            except FileFormatError:  # not rendered either
                add(None)
    add(scene.lights)
    environment = image_light(scene.lights)
    if environment is not None:
        add(texels_of(environment))
    add(scene.background)
    return digest.hexdigest()
