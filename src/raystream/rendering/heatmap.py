"""heatmap: the traversal cost of each pixel's rays, in false colours."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.checks import check_choice
from raystream.core.choices import DeviceOptions
from raystream.jit.threads import Progress, part_of
from raystream.rendering.arguments import check_camera, check_samples, check_size, make_tracer
from raystream.rendering.camera_paths import camera_paths
from raystream.rendering.false_colors import check_maximum, draw_counts
from raystream.rendering.image import Image
from raystream.rendering.sampling.sampler import Sampler
from raystream.scene.camera import Camera
from raystream.scene.scene import Scene
from raystream.structures import StructureOptions
from raystream.tracer import Tracer

if TYPE_CHECKING:
    from raystream.machines import Passes, RayCounters

__all__ = ["HEATMAPS", "Heatmap", "PassCost", "RayCost", "heatmap", "title_of"]

#: The counts that a heat map can show, and their titles; see `title_of`.
HEATMAPS: dict[str, str] = {
    "cells": "cells visited",
    "tests": "triangles tested",
    "steps": "traversal steps",
}

#: Rays traced at a time: bounds memory to about 40 MB.
_RAYS_PER_BAND = 1 << 18


@dataclass(frozen=True)
class RayCost:
    """One of the counts, over all rays of a heat map.

    Attributes
    ----------
    mean : float
        Per ray.
    most : int
        The largest count of a single ray.
    total : int
    """

    mean: float
    most: int
    total: int


@dataclass(frozen=True)
class PassCost:
    """The passes that a multipass machine ran for a heat map.

    Attributes
    ----------
    count : int
        Passes.
    optimal_count : int
        The minimum for any scheduler; see `raystream.machines.Passes`.

    Notes
    -----
    Rays are traced in batches of 2**18, and the passes of all batches are added up.
    """

    count: int
    optimal_count: int


@dataclass(frozen=True, eq=False)
class Heatmap:
    """The traversal cost of each pixel's rays.

    Attributes
    ----------
    what : {"cells", "tests", "steps"}
        The count shown.
    counts : ndarray of shape (H, W), float32
        The mean over each pixel's rays.
    costs : dict of str to RayCost
        All counts by name, not only the one shown.
    structure : str
        Name of the structure.
    passes : PassCost or None
        Only with a multipass machine.
    maximum : float, optional
        Top of the scale [default: the largest count]. ``dataclasses.replace(heat, maximum=50)``
        draws the same counts on another scale.
    """

    what: str
    counts: NDArray[np.float32]
    costs: Mapping[str, RayCost]
    structure: str
    passes: PassCost | None = None
    maximum: float | None = None

    @cached_property
    def image(self) -> Image:
        """The image: the counts, with a scale bar below."""
        return Image(draw_counts(self.counts, self.title, self.maximum))

    @property
    def title(self) -> str:
        """The count shown, with its mean and maximum per ray."""
        cost = self.costs[self.what]
        mean = f"{cost.mean:,.1f}" if cost.mean >= 10.0 else f"{cost.mean:.3g}"
        return f"{title_of(self.what, self.structure)} per ray, mean {mean}, most {cost.most:,}"

    def save(self, path: str | PathLike[str]) -> None:
        """Write the image to a file, see `Image.save`."""
        self.image.save(path)

    def _repr_png_(self) -> bytes:
        """Show the image in a notebook."""
        return self.image._repr_png_()

    def __repr__(self) -> str:
        height, width = self.counts.shape
        return f"Heatmap({width}x{height}, {self.title})"


def heatmap(
    scene: Scene | Tracer,
    what: str = "steps",
    size: tuple[int, int] = (1024, 768),
    samples: int = 1,
    structure: str | StructureOptions = "bvh",
    device: str | DeviceOptions = "cpu",
    *,
    camera: Camera | None = None,
    maximum: float | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    **options: Any,
) -> Heatmap:
    """Draw the cost of finding the first hits of each pixel's rays.

    Parameters
    ----------
    scene : Scene or Tracer
        A tracer must have been made with ``counters=True``.
    what : {"steps", "cells", "tests"}
        Traversal steps, down and back up; visited cells of a grid, or leaves of a tree; or
        triangle tests. See `raystream.machines.RayCounters`.
    size : (int, int)
        Width and height in pixels, without the scale bar.
    samples : int
        Rays per pixel: the camera rays of `render`.
    structure, device, **options
        See `Tracer`; not allowed if `scene` is a tracer.
    camera : Camera, optional
        The view [default: the scene's camera, or one chosen by `Scene.camera_for`].
    maximum : float, optional
        Top of the scale, to make images comparable [default: the largest count of a pixel].
        Larger counts are clamped, and the scale bar says so.
    seed : int
        Seed of the samples' positions, 0 to 2**32 - 1.
    progress : callable, optional
        Called with (rays done, rays).

    Returns
    -------
    Heatmap
        With the image, the counts, and their statistics.

    Raises
    ------
    ValueError
        If a name is unknown, a number out of range, or the tracer does not count.
    TypeError
        If `scene` is neither a scene nor a tracer, or `camera` is not a camera.
    MemoryError
        If the image does not fit into memory.
    """
    check_choice("what", what, HEATMAPS)
    width, height = check_size(size)
    samples = check_samples(samples)
    sampler = Sampler.of("sobol", seed, samples)
    check_camera(camera)
    check_maximum(maximum)
    if not isinstance(scene, Tracer):
        options = {"counters": True, **options}
    tracer = make_tracer(scene, structure, device, options)
    if not tracer.is_counting:
        raise ValueError("scene: a heat map needs a tracer made with counters=True")
    camera = camera or tracer.scene.camera_for(width / height)

    sums = np.zeros(height * width, np.int64)
    totals = {name: _Totals() for name in HEATMAPS}
    passes: list[Passes] = []
    for pixels, counters in _trace(tracer, camera, (width, height), sampler, progress):
        counts = {"cells": counters.cells, "tests": counters.tests, "steps": counters.all_steps}
        for name, total in totals.items():
            total.add(counts[name])
        sums[pixels] += counts[what]
        if counters.passes is not None:
            passes.append(counters.passes)
    means = (sums / samples).astype(np.float32).reshape(height, width)
    costs = {name: total.cost(len(sums) * samples) for name, total in totals.items()}
    return Heatmap(what, means, costs, tracer.structure.name, _add_up(passes), maximum)


def _trace(
    tracer: Tracer,
    camera: Camera,
    size: tuple[int, int],
    sampler: Sampler,
    progress: Progress | None,
) -> Iterator[tuple[NDArray[np.int64], RayCounters]]:
    """Trace a ray per pixel and sample; yield the pixels and the counters of each batch.

    Queries run one at a time, on all threads: `Tracer.counters` are of the last one.
    """
    width, height = size
    samples = sampler.sample_count
    ray_count = width * height * samples
    rows_per_band = max(1, _RAYS_PER_BAND // width)
    done = 0
    for first in range(0, height, rows_per_band):
        rows = range(first, min(first + rows_per_band, height))
        for sample in range(samples):
            paths = camera_paths(camera, size, sampler, rows, sample)
            report = part_of(progress, done, len(paths.pixels), ray_count)
            tracer.first_hit(paths.origins, paths.directions, progress=report)
            yield paths.pixels, tracer.counters
            done += len(paths.pixels)


@dataclass
class _Totals:
    """Accumulates the counts of rays."""

    most: int = 0
    total: int = 0

    def add(self, counts: NDArray[Any]) -> None:
        self.most = max(self.most, int(counts.max()))
        self.total += int(counts.sum(dtype=np.int64))

    def cost(self, ray_count: int) -> RayCost:
        return RayCost(self.total / ray_count, self.most, self.total)


def _add_up(passes: list[Passes]) -> PassCost | None:
    """The passes of several queries together."""
    if not passes:
        return None
    return PassCost(sum(map(len, passes)), sum(one.optimal_count for one in passes))


def title_of(what: str, structure: str) -> str:
    """Name of the count: cells of structures other than a grid are leaves."""
    is_leaves = what == "cells" and structure != "grid"
    return "leaves visited" if is_leaves else HEATMAPS[what]
