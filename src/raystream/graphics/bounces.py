"""Mirror reflections by fragment programs alone, without recursion (Christen 2005).

Textures hold the state of each pixel, and one program after the other runs over all pixels. An
iteration traces the rays, sums the light at their hits, light by light, adds it, weighted, to the
iteration buffer, and generates the reflected rays.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from raystream.core.query import Kind
from raystream.graphics.adapters import OpenDevice, open_device
from raystream.graphics.buffers import Buffer, uniform, upload, whole
from raystream.graphics.camera import check_pinhole, packed_view
from raystream.graphics.error_scope import guarded
from raystream.graphics.errors import GraphicsError
from raystream.graphics.fragment_program import FragmentProgram
from raystream.graphics.pipelines import Program
from raystream.graphics.shader_source import shader_source
from raystream.graphics.structures import shader_structure_of
from raystream.graphics.surfaces import SurfaceArrays, check_surfaces
from raystream.graphics.textures import FLOATS, WORDS, Texture, sampled
from raystream.rendering.arguments import check_camera, check_size, make_tracer
from raystream.rendering.image import Image
from raystream.rendering.render import RENDERERS
from raystream.scene.camera import Camera
from raystream.scene.scene import Scene
from raystream.structures import Structure
from raystream.tracer import Tracer

__all__ = ["render_bounces"]


def render_bounces(
    scene: Scene | Tracer,
    size: tuple[int, int] = (1024, 768),
    structure: str = "bvh",
    *,
    camera: Camera | None = None,
    max_bounces: int = 8,
    min_weight: float = 1.0 / 512.0,
    adapter: str | None = None,
    **options: Any,
) -> Image:
    """Render an image with shadows and mirrors by fragment programs.

    Parameters
    ----------
    scene : Scene or Tracer
        A tracer's structure is reused; its device does not matter.
    size : (int, int)
        Width and height in pixels.
    structure, **options
        See `Tracer`; not with a tracer as `scene`.
    camera : Camera, optional
        Perspective; a lens is taken as a pinhole [default: the scene's].
    max_bounces : int
        Most reflections on a path: there is one iteration more.
    min_weight : float
        Paths end when no channel of their weight is greater.
    adapter : str, optional
        See `adapters.open_device`.

    Returns
    -------
    Image
        Linear RGB, that of ``render(scene, "whitted")`` but for float32, which moves the outlines
        of reflected objects a little. Its figures are ``iterations`` and ``passes``; each pass
        draws all pixels once.

    Raises
    ------
    ValueError
        If an argument is out of range, or the scene has unsupported features: glass (a pixel
        stores one ray), textures other than diffuse ones, rough or partly transparent surfaces,
        or an environment map.
    GraphicsError
        If there is no adapter, the scene or the image is too large for it, or a ray's search
        did not end.

    References
    ----------
    Christen, "Ray Tracing on GPU", 2005, sections 5.2 and 5.4.
    """
    check_camera(camera)
    size = check_size(size)
    chosen = RENDERERS["whitted"].check({"max_bounces": max_bounces, "min_weight": min_weight})
    given = scene.scene if isinstance(scene, Tracer) else scene
    if isinstance(given, Scene):
        check_surfaces(given)
    if isinstance(scene, Tracer):
        tracer = make_tracer(scene, "bvh", "cpu", options)
    else:
        tracer = make_tracer(scene, structure, "cpu", options)
    view = camera or tracer.scene.camera_for(size[0] / size[1])
    check_pinhole(view)
    opened = open_device(adapter)
    mirrors = any(any(one.reflection) for one in tracer.scene.materials)
    least = chosen["min_weight"]
    with guarded(opened):
        pipeline = _Pipeline(tracer.structure, tracer.scene, view, size, opened, least)
        return pipeline.render(chosen["max_bounces"] + 1 if mirrors else 1)


class _Pipeline:
    """The programs, and the textures between them."""

    def __init__(
        self,
        structure: Structure,
        scene: Scene,
        view: Camera,
        size: tuple[int, int],
        opened: OpenDevice,
        min_weight: float,
    ) -> None:
        self._opened, self._size, self._shaders = (
            opened,
            size,
            shader_structure_of(structure),
        )
        shaders = self._shaders
        names = (f"{shaders.name}, array {k}" for k in range(len(shaders.arrays)))
        self._tree = upload(opened, zip(names, shaders.arrays, strict=True))
        self._search = uniform(opened, shaders.params(structure.triangles.max_coordinate))
        self._arrays = SurfaceArrays(scene, view, opened)
        packed = packed_view(view, size, scene.triangles)
        self._params = [
            uniform(opened, self._arrays.params(number, min_weight, packed))
            for number in range(max(self._arrays.light_count, 1))
        ]
        self._make_programs()
        self._make_screens()
        self._pass_count = 0

    def _make_programs(self) -> None:
        opened, shaders = self._opened, self._shaders
        seen, lit = len(self._arrays.surfaces), len(self._arrays.lit_surfaces)

        def program(name: str, reads: Sequence[str], writes: Sequence[str], count: int) -> Any:
            source = shader_source("fullscreen.wgsl", f"bounces/{name}.wgsl")
            layouts = [("uniform", *map(sampled, reads)), ("gather",) * count]
            return FragmentProgram(opened, name, Program(source, name, layouts), writes)

        def search(kind: Kind) -> Any:
            source = shaders.source("fullscreen.wgsl", "bounces/trace.wgsl")
            rays = sampled(FLOATS), sampled(FLOATS)
            layouts = [("uniform", *rays, "scatter"), ("gather",) * len(shaders.arrays)]
            constants = {"QUERY": float(kind), **shaders.constants}
            program = Program(source, "trace", layouts, constants)
            return FragmentProgram(opened, "trace", program, [WORDS])

        hit = [FLOATS, WORDS]
        self._camera_rays = program("camera_rays", [], [FLOATS, FLOATS], 0)
        self._first_hit, self._any_hit = search(Kind.FIRST_HIT), search(Kind.ANY_HIT)
        self._emission = program("emission", hit, [FLOATS], seen)
        self._shadow_rays = program("shadow_rays", hit, [FLOATS, FLOATS], lit)
        self._add_light = program("add_light", [*hit, WORDS, FLOATS], [FLOATS], lit)
        self._accumulate = program("accumulate", [*hit, *[FLOATS] * 3], [FLOATS, FLOATS], seen)
        self._reflect = program("reflect", [*hit, FLOATS], [FLOATS, FLOATS], seen)

    def _make_screens(self) -> None:
        def screens(name: str, count: int, kind: str = FLOATS) -> list[Texture]:
            return [Texture(self._opened, name, self._size, kind) for _ in range(count)]

        # Pairs: one is read while the other is written.
        self._rays, self._next_rays = screens("rays", 2), screens("next rays", 2)
        self._light, self._next_light = screens("light", 2)
        self._buffer, self._next_buffer = screens("colours", 2), screens("weights", 2)
        self._to_light = screens("rays to lights", 2)
        self._hits, self._blocked = screens("hits", 2, WORDS)
        self._failures = Buffer(self._opened, "counts of failures")
        self._failures.reserve(8)
        self._failed = (
            f"took more than {self._shaders.budget:,} steps and tests",
            "were cut short by a driver that ends long loops; take another structure",
        )

    def render(self, iterations: int) -> Image:
        """Run all programs, and read the image back."""
        self._failures.write(np.zeros(2, np.uint32))
        encoder = self._opened.device.create_command_encoder()
        self._buffer[0].clear(encoder, 0.0)
        self._buffer[1].clear(encoder, 1.0)
        self._draw(encoder, self._camera_rays, [], self._rays)
        for _ in range(iterations):
            self._iterate_once(encoder)
            # Submitted one by one: drivers take long submissions for hung.
            self._opened.device.queue.submit([encoder.finish()])
            encoder = self._opened.device.create_command_encoder()
        pixels = self._buffer[0].read()[..., :3]
        failures = self._failures.read(np.uint32, (2,))
        for count, what in zip(failures.tolist(), self._failed, strict=True):
            if count:
                raise GraphicsError(
                    f"device 'graphics': {count:,} rays in {self._shaders.name!r} {what} "
                    f"({self._opened.adapter})"
                )
        return Image(pixels, figures={"iterations": iterations, "passes": self._pass_count})

    def _iterate_once(self, encoder: Any) -> None:
        surfaces, lights = self._arrays.surfaces, self._arrays.lit_surfaces
        hit = [self._rays[1], self._hits]
        self._trace(encoder, self._first_hit, self._rays, self._hits)
        self._draw(encoder, self._emission, hit, [self._light], surfaces)
        for number in range(self._arrays.light_count):
            self._draw(encoder, self._shadow_rays, hit, self._to_light, lights, number)
            self._trace(encoder, self._any_hit, self._to_light, self._blocked)
            reads = [*hit, self._blocked, self._light]
            self._draw(encoder, self._add_light, reads, [self._next_light], lights, number)
            self._light, self._next_light = self._next_light, self._light
        color, weight = self._buffer
        reads = [*hit, self._light, weight, color]
        self._draw(encoder, self._accumulate, reads, self._next_buffer, surfaces)
        self._buffer, self._next_buffer = self._next_buffer, self._buffer
        self._draw(encoder, self._reflect, [*hit, self._buffer[1]], self._next_rays, surfaces)
        self._rays, self._next_rays = self._next_rays, self._rays

    def _trace(
        self, encoder: Any, program: FragmentProgram, rays: Sequence[Texture], found: Texture
    ) -> None:
        own = [whole(self._search), *(one.view for one in rays), self._failures.binding]
        program.draw(encoder, [own, [one.binding for one in self._tree]], [found])
        self._pass_count += 1

    def _draw(
        self,
        encoder: Any,
        program: FragmentProgram,
        reads: Sequence[Texture],
        writes: Sequence[Texture],
        gathers: Sequence[Buffer] = (),
        number: int = 0,
    ) -> None:
        own = [whole(self._params[number]), *(one.view for one in reads)]
        program.draw(encoder, [own, [one.binding for one in gathers]], writes)
        self._pass_count += 1
