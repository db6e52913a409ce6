"""``raystream query``: rays from a file, hits to a file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from raystream.cli import options
from raystream.cli.bars import Bars
from raystream.cli.compiling import compiling
from raystream.cli.console import BadInputError, one_line, refuse, write_json, write_line
from raystream.cli.load import Source, Stopwatch, choose_threads, open_tracer, rays_per_second
from raystream.cli.tracer_options import machine_figures, tracer_options
from raystream.cli.zarr_query import check_stores, is_store, trace_store

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from raystream.core.hits import Hits, MultiHits
    from raystream.jit.threads import Progress
    from raystream.ray_files import QueryReport
    from raystream.tracer import Tracer

__all__ = ["query"]

CROSSINGS = ("triangles", "surfaces")

#: Arrays of a ray file; the first two are required.
RAY_ARRAYS = ("origins", "directions", "t_min", "t_max")

#: Arrays written for each kind of query.
COLUMNS = {
    "first": ("t", "u", "v", "prim_id", "mesh_id", "status"),
    "multi": ("ray_splits", "t", "u", "v", "prim_id", "status"),
}


def query(
    scene: options.SceneName,
    rays: Annotated[
        Path,
        typer.Argument(
            metavar="RAYS",
            help="An .npz file, or a Zarr store of any size (.zarr, a folder, or .zip), with "
            "arrays origins and directions of shape (..., 3), and optionally t_min and t_max.",
            show_default=False,
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="Output file for the hits: .npz, or .zarr for rays in a Zarr store.",
            show_default=False,
        ),
    ],
    first: Annotated[
        bool, typer.Option("--first", help="Nearest hit of each ray (the default).")
    ] = False,
    anything: Annotated[
        bool, typer.Option("--any", help="Whether each ray hits anything.")
    ] = False,
    multi: Annotated[bool, typer.Option("--multi", help="All hits of each ray.")] = False,
    count: Annotated[bool, typer.Option("--count", help="Number of hits of each ray.")] = False,
    max_hits: Annotated[
        int | None,
        typer.Option(
            min=0, metavar="K", show_default=False, help="With --multi: keep the nearest K hits."
        ),
    ] = None,
    crossings: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="With --multi or --count: triangles, a ray through an edge hits every triangle "
            "that shares it; or surfaces, it crosses each surface once [default: triangles]",
            show_default=False,
            callback=options.one_of(CROSSINGS),
            autocompletion=options.complete(CROSSINGS),
        ),
    ] = None,
    structure: options.Structure = None,
    traversal: options.Traversal = None,
    machine: options.Machine = None,
    scheduler: options.Scheduler = None,
    option: options.TracerOption = None,
    device: options.Device = "cpu",
    adapter: options.Adapter = None,
    gpu: options.Gpu = None,
    threads: options.Threads = None,
    time: options.Time = 0.0,
    triangles: options.Triangles = None,
    resume: Annotated[
        bool,
        typer.Option(
            "--resume",
            help="With .zarr: resume an interrupted query, if there is one.",
        ),
    ] = False,
    block_rays: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            show_default=False,
            help="With .zarr: approximate number of rays in memory at a time [default: 1048576]",
        ),
    ] = None,
    json: options.Json = False,
) -> None:
    """Trace the rays of a file and write their hits to a file.

    The hits are arrays: t, u, v, prim_id, mesh_id, status with --first; hit with --any;
    ray_splits, t, u, v, prim_id, status with --multi; count with --count.

    Rays in a Zarr store are traced block by block in bounded memory.
    """
    chosen = {"first": first, "any": anything, "multi": multi, "count": count}
    request = _QueryOptions(_only(chosen), max_hits, crossings)
    in_store = is_store(rays, output)
    if in_store:
        check_stores(rays, output)
    elif resume or block_rays is not None:
        name = "--resume" if resume else "--block-rays"
        raise BadInputError(f"{name}: only with rays and hits in Zarr stores")
    else:
        options.check_output(output, (".npz",), inputs=[scene, str(rays)])
    tracing = tracer_options(
        option or [],
        device,
        adapter=adapter,
        gpu=gpu,
        traversal=traversal,
        machine=machine,
        scheduler=scheduler,
    )
    choose_threads(threads)
    watch = Stopwatch()
    with Bars() as bars, compiling(f"query-{request.kind}", structure, device, watch):
        given = {} if in_store else _read_rays(rays)
        source = Source(scene, structure, device, time, triangles, tracing)
        tracer = open_tracer(source, bars, watch)
        found: QueryReport | _Results
        if in_store:
            options_given = request.options
            if block_rays is not None:
                options_given["block_rays"] = block_rays
            found = trace_store(
                tracer,
                rays,
                output,
                request.kind,
                options_given,
                resume=resume,
                bars=bars,
                watch=watch,
            )
        else:
            found = _trace_file(tracer, given, output, request, bars, watch)
    speed = rays_per_second(found.rays - found.rays_before, watch.seconds["trace"])
    triangle_count = len(tracer.structure.triangles)
    if json:
        write_json(
            {
                "output": str(output),
                "scene": scene,
                "query": request.kind,
                "structure": tracer.structure.name,
                **machine_figures(tracing, device),
                "triangles": triangle_count,
                "rays": found.rays,
                **({"rays_before": found.rays_before} if in_store else {}),
                "invalid_rays": found.invalid_rays,
                "rays_hit": found.rays_hit,
                "hits": found.hits,
                "seconds": watch.rounded(),
                "mrays_per_second": speed,
            }
        )
    else:
        invalid = f" ({found.invalid_rays:,} invalid)" if found.invalid_rays else ""
        hits = f", {found.hits:,} hits" if request.kind in ("multi", "count") else ""
        write_line(
            f"{one_line(str(output))}: {found.rays:,} rays{invalid}, {found.rays_hit:,} "
            f"hit{hits}; {triangle_count:,} triangles; {watch.text()}; {speed:g} Mrays/s"
        )


def _trace_file(
    tracer: Tracer,
    rays: dict[str, NDArray[Any]],
    output: Path,
    request: _QueryOptions,
    bars: Bars,
    watch: Stopwatch,
) -> _Results:
    """Trace rays that are in memory, and write the hits to an ``.npz`` file."""
    from raystream.core.npz import write_npz

    with watch.measure("trace"), bars.step("tracing") as progress:
        results = request.run(tracer, rays, progress)
    with watch.measure("save"), bars.step("saving"), refuse(OSError, where=str(output)):
        write_npz(output, results.arrays)
    return results


def _only(chosen: dict[str, bool]) -> str:
    names = [name for name, is_chosen in chosen.items() if is_chosen]
    if len(names) > 1:
        raise BadInputError(f"{' and '.join(f'--{name}' for name in names)}: choose one")
    return names[0] if names else "first"


def _read_rays(path: Path) -> dict[str, NDArray[Any]]:
    """Read a ray file, checking shapes and dtypes."""
    from raystream.core.errors import FileFormatError
    from raystream.core.npz import read_npz
    from raystream.core.rays import RayBatch

    arrays = read_npz(path)
    for name in arrays:
        if name not in RAY_ARRAYS:
            raise FileFormatError(path, f"holds {name!r}; expected {', '.join(RAY_ARRAYS)}")
    for name in RAY_ARRAYS[:2]:
        if name not in arrays:
            raise FileFormatError(path, f"array {name!r} is missing")
    with refuse(ValueError, TypeError, where=str(path)):
        RayBatch(**arrays)
    return arrays


@dataclass(frozen=True)
class _Results:
    """Output arrays, and figures about them."""

    arrays: dict[str, NDArray[Any]]
    rays: int
    invalid_rays: int | None  # None if the query does not report them
    rays_hit: int
    hits: int
    rays_before: int = 0


@dataclass(frozen=True)
class _QueryOptions:
    """A kind of query with its options."""

    kind: str
    max_hits: int | None
    crossings: str | None

    def __post_init__(self) -> None:
        if self.max_hits is not None and self.kind != "multi":
            raise BadInputError("--max-hits: only with --multi")
        if self.crossings is not None and self.kind not in ("multi", "count"):
            raise BadInputError("--crossings: only with --multi or --count")

    @property
    def options(self) -> dict[str, Any]:
        """Return the options that were given, by the tracer's names."""
        given = {"max_hits": self.max_hits, "crossings": self.crossings}
        return {name: value for name, value in given.items() if value is not None}

    def run(
        self, tracer: Tracer, rays: dict[str, NDArray[Any]], progress: Progress | None
    ) -> _Results:
        """Trace the rays.

        Parameters
        ----------
        tracer : Tracer
        rays : dict of str to ndarray
            Ray arguments of a query, by name.
        progress : callable or None
        """
        import numpy as np

        options: dict[str, Any] = {**rays, **self.options, "progress": progress}
        if self.kind == "any":
            seen = tracer.any_hit(**options)
            hit_count = int(np.count_nonzero(seen))
            return _Results({"hit": seen}, seen.size, None, hit_count, hit_count)
        if self.kind == "count":
            counts = tracer.count_hits(**options)
            rays_hit, hit_count = int(np.count_nonzero(counts)), int(counts.sum())
            return _Results({"count": counts}, counts.size, None, rays_hit, hit_count)
        hits: Hits | MultiHits
        if self.kind == "multi":
            hits = tracer.multi_hit(**options)
            rays_hit, hit_count = int(np.count_nonzero(hits.counts)), len(hits.t)
        else:
            hits = tracer.first_hit(**options)
            rays_hit = hit_count = int(np.count_nonzero(hits.is_hit))
        arrays = {name: getattr(hits, name) for name in COLUMNS[self.kind]}
        invalid_count = int(np.count_nonzero(hits.status))
        return _Results(arrays, hits.status.size, invalid_count, rays_hit, hit_count)
