"""heatmap: what the rays of each pixel cost, in false colours."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.choices import DeviceOptions
from raystream.jit.threads import Progress
from raystream.rendering.arguments import check_camera, check_samples, check_size, make_tracer
from raystream.rendering.false_colors import check_maximum, draw_counts
from raystream.rendering.image import Image
from raystream.rendering.integrator import camera_paths
from raystream.rendering.sampling.sampler import Sampler
from raystream.scene.camera import Camera
from raystream.scene.scene import Scene
from raystream.structures import StructureOptions
from raystream.tracer import Tracer

if TYPE_CHECKING:
    from raystream.machines import Passes, RayCounters

__all__ = ["HEATMAPS", "Heatmap", "PassCost", "RayCost", "heatmap"]

#: What a heat map can show, and what its title says; see `_title_of`.
HEATMAPS: dict[str, str] = {
    "cells": "cells visited",
    "tests": "triangles tested",
    "steps": "traversal steps",
}

#: Rays that are traced at a time: bounds memory at about 40 MB.
_RAYS_PER_BAND = 1 << 18


@dataclass(frozen=True)
class RayCost:
    """One of the counts, over all rays of a heat map.

    Attributes
    ----------
    mean : float
        For each ray.
    most : int
        Of any ray.
    total : int
    """

    mean: float
    most: int
    total: int


@dataclass(frozen=True)
class PassCost:
    """What a multipass machine ran for a heat map.

    Attributes
    ----------
    count : int
        Passes.
    optimal_count : int
        No scheduler needs fewer; see `raystream.machines.Passes`.

    Notes
    -----
    Rays are traced 2**18 at a time, and the passes of each time are added up.
    """

    count: int
    optimal_count: int


@dataclass(frozen=True, eq=False)
class Heatmap:
    """What the rays of each pixel cost.

    Attributes
    ----------
    what : {"cells", "tests", "steps"}
        The count that is shown.
    counts : ndarray of shape (H, W), float32
        For each pixel, the mean over its rays.
    costs : dict of str to RayCost
        By the name of the count; all of them, not only the one shown.
    structure : str
        In which rays were traced.
    passes : PassCost or None
        Of a multipass machine.
    maximum : float, optional
        Top of the scale; None takes the largest of the counts. ``dataclasses.replace(heat,
        maximum=50)`` draws the same counts by another scale.
    """

    what: str
    counts: NDArray[np.float32]
    costs: Mapping[str, RayCost]
    structure: str
    passes: PassCost | None = None
    maximum: float | None = None

    @cached_property
    def image(self) -> Image:
        """The picture: the counts, and a scale below that adds to the height."""
        return Image(draw_counts(self.counts, self.title, self.maximum))

    @property
    def title(self) -> str:
        """What is shown, with the mean and the most of a ray."""
        cost = self.costs[self.what]
        mean = f"{cost.mean:,.1f}" if cost.mean >= 10.0 else f"{cost.mean:.3g}"
        return f"{_title_of(self.what, self.structure)} per ray, mean {mean}, most {cost.most:,}"

    def save(self, path: str | PathLike[str]) -> None:
        """Write the picture to a file, see `Image.save`."""
        self.image.save(path)

    def _repr_png_(self) -> bytes:
        """Show the picture in a notebook."""
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
    """Draw what the first hit of each pixel's rays costs.

    Parameters
    ----------
    scene : Scene or Tracer
        A tracer must have been made with ``counters=True``.
    what : {"steps", "cells", "tests"}
        Steps of the traversal, down and back up; cells of a grid that were visited, or leaves
        of a tree; or triangles that were tested. See `raystream.machines.RayCounters`.
    size : (int, int)
        Width and height of the rendered part, in pixels. The scale below it adds to the
        height of the picture.
    samples : int
        Rays for each pixel, the same that `render` sends from the eye.
    structure, device, **options
        See `Tracer`; not to be given together with one.
    camera : Camera, optional
        The view; without it, the scene's, or one that frames it.
    maximum : float, optional
        Top of the scale, so that pictures can be compared; larger counts are drawn as the
        top, and the scale says so. Without it, the largest count of a pixel.
    seed : int
        For the places of the samples, 0 to 2**32 - 1.
    progress : callable, optional
        Called with (rays done, rays).

    Returns
    -------
    Heatmap
        With the picture, the counts, and figures about them.

    Raises
    ------
    ValueError
        If a name is unknown, a number out of range, or the tracer does not count.
    TypeError
        If `scene` is neither a scene nor a tracer, or `camera` no camera.
    MemoryError
        If so large a picture does not fit into memory.
    """
    if what not in HEATMAPS:
        known = ", ".join(repr(known) for known in HEATMAPS)
        raise ValueError(f"what: expected one of {known}, got {what!r}")
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
    tallies = {name: _Tally() for name in HEATMAPS}
    passes: list[Passes] = []
    for pixels, counters in _trace(tracer, camera, (width, height), sampler, progress):
        counts = {"cells": counters.cells, "tests": counters.tests, "steps": counters.all_steps}
        for name, tally in tallies.items():
            tally.add(counts[name])
        sums[pixels] += counts[what]
        if counters.passes is not None:
            passes.append(counters.passes)
    means = (sums / samples).astype(np.float32).reshape(height, width)
    costs = {name: tally.cost(len(sums) * samples) for name, tally in tallies.items()}
    return Heatmap(what, means, costs, tracer.structure.name, _add_up(passes), maximum)


def _trace(
    tracer: Tracer,
    camera: Camera,
    size: tuple[int, int],
    sampler: Sampler,
    progress: Progress | None,
) -> Iterator[tuple[NDArray[np.int64], RayCounters]]:
    """Trace a ray for each pixel and sample; give the pixels and the counters of some at a time.

    One query runs at a time, on all threads: the counters are those of the last one.
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
            report = _part_of(progress, done, len(paths.pixels), ray_count)
            tracer.first_hit(paths.origins, paths.directions, progress=report)
            yield paths.pixels, tracer.counters
            done += len(paths.pixels)


@dataclass
class _Tally:
    """Adds up the counts of rays."""

    most: int = 0
    total: int = 0

    def add(self, counts: NDArray[Any]) -> None:
        self.most = max(self.most, int(counts.max()))
        self.total += int(counts.sum(dtype=np.int64))

    def cost(self, ray_count: int) -> RayCost:
        return RayCost(self.total / ray_count, self.most, self.total)


def _part_of(progress: Progress | None, first: int, count: int, total: int) -> Progress | None:
    """The callback for a query of `count` rays that begins after `first` of `total`."""
    if progress is None:
        return None
    whole = progress
    return lambda done, steps: whole(first + count * done // steps, total)


def _add_up(passes: list[Passes]) -> PassCost | None:
    """The passes of several queries together."""
    if not passes:
        return None
    return PassCost(sum(map(len, passes)), sum(one.optimal_count for one in passes))


def _title_of(what: str, structure: str) -> str:
    """What is counted: the cells of everything but a grid are leaves."""
    is_leaves = what == "cells" and structure != "grid"
    return "leaves visited" if is_leaves else HEATMAPS[what]
