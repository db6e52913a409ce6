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
from raystream.cli.load import (
    Stopwatch,
    choose_threads,
    open_tracer,
    rays_per_second,
    triangle_figures,
    triangle_text,
)
from raystream.cli.option_groups import expand_groups
from raystream.cli.tracer_options import TracerOptions
from raystream.cli.zarr_query import QUERIES, check_stores, is_store, trace_store

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from raystream.jit.threads import Progress
    from raystream.ray_files import QueryReport
    from raystream.tracer import Tracer

CROSSINGS = ("triangles", "surfaces")

#: Arrays of a ray file; the first two are required.
RAY_ARRAYS = ("origins", "directions", "t_min", "t_max")


@dataclass(frozen=True)
class QueryOptions:
    """Options of what to find for each ray."""

    first: Annotated[
        bool,
        options.flag("--first", "Nearest hit of each ray (the default)."),
    ] = False
    any: Annotated[bool, options.flag("--any", "Whether each ray hits anything.")] = False
    multi: Annotated[bool, options.flag("--multi", "All hits of each ray.")] = False
    count: Annotated[bool, options.flag("--count", "Number of hits of each ray.")] = False
    max_hits: Annotated[
        int | None, options.count("With --multi: keep the nearest K hits.", least=0, metavar="K")
    ] = None
    crossings: Annotated[
        str | None,
        options.choice(
            CROSSINGS,
            "With --multi or --count, what a ray through an edge hits: triangles, every triangle "
            "that shares it; or surfaces, each surface once [default: triangles]",
        ),
    ] = None

    @property
    def kind(self) -> str:
        """The kind of query: a key of `zarr_query.QUERIES`."""
        names = [name for name in QUERIES if getattr(self, name)]
        if len(names) > 1:
            raise BadInputError(f"{' and '.join(f'--{name}' for name in names)}: choose one")
        return names[0] if names else "first"

    def arguments(self) -> dict[str, Any]:
        """Return the query's own arguments.

        Raises
        ------
        BadInputError
            If options contradict each other.
        """
        if self.max_hits is not None and self.kind != "multi":
            raise BadInputError("--max-hits: only with --multi")
        if self.crossings is not None and self.kind not in ("multi", "count"):
            raise BadInputError("--crossings: only with --multi or --count")
        given = {"max_hits": self.max_hits, "crossings": self.crossings}
        return {name: value for name, value in given.items() if value is not None}


@dataclass(frozen=True)
class StoreOptions:
    """Options of a query over Zarr stores."""

    resume: Annotated[
        bool, options.flag("--resume", "With .zarr: resume an interrupted query, if there is one.")
    ] = False
    block_rays: Annotated[
        int | None,
        options.count(
            "With .zarr: approximate number of rays in memory at a time [default: 1048576]"
        ),
    ] = None


@expand_groups
def query(
    scene: options.SceneName,
    rays: Annotated[
        Path,
        typer.Argument(
            metavar="RAYS",
            help="An .npz file, or a Zarr store of any size (.zarr, a folder, or .zip), with "
            "arrays origins and directions of shape (..., 3), and optionally t_min and t_max.",
        ),
    ],
    output: Annotated[
        Path, options.output("Output file for the hits: .npz, or .zarr for rays in a Zarr store.")
    ],
    *,
    what: QueryOptions,
    tracing: TracerOptions,
    threads: options.Threads = None,
    loading: options.SceneOptions,
    store: StoreOptions,
    json: options.Json = False,
) -> None:
    """Trace the rays of a file and write their hits to a file.

    The hits are arrays: t, u, v, prim_id, mesh_id, face_id, status with --first; hit with --any;
    ray_splits, t, u, v, prim_id, mesh_id, face_id, status with --multi; count with --count. In a
    scene with instances, --first and --multi also write instance_id.

    Rays in a Zarr store are traced block by block in bounded memory.
    """
    kind, arguments = what.kind, what.arguments()
    in_store = is_store(rays, output)
    if in_store:
        check_stores(rays, output)
    elif store != StoreOptions():
        name = "--resume" if store.resume else "--block-rays"
        raise BadInputError(f"{name}: only with rays and hits in Zarr stores")
    else:
        options.check_output(output, (".npz",), inputs=[scene, str(rays)])
    chosen = tracing.arguments()
    choose_threads(threads)
    watch = Stopwatch()
    with Bars() as bars, compiling(f"query-{kind}", chosen, watch):
        given = {} if in_store else _read_rays(rays)
        tracer = open_tracer(scene, loading, chosen, bars, watch)
        found: QueryReport | _Results
        if in_store:
            if store.block_rays is not None:
                arguments["block_rays"] = store.block_rays
            arguments["resume"] = store.resume
            found = trace_store(tracer, rays, output, kind, arguments, bars, watch)
        else:
            with watch.measure("trace"), bars.step("tracing") as progress:
                found = _run(kind, tracer, {**given, **arguments}, progress)
            with watch.measure("save"), bars.step("saving"), refuse(OSError, where=str(output)):
                from raystream.core.npz import write_npz

                write_npz(output, found.arrays)
    speed = rays_per_second(found.rays - found.rays_before, watch.seconds["trace"])
    if json:
        write_json(
            {
                "output": str(output),
                "scene": scene,
                "query": kind,
                "structure": tracer.structure.name,
                **chosen.figures(),
                **triangle_figures(tracer.scene),
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
        hits = f", {found.hits:,} hits" if kind in ("multi", "count") else ""
        write_line(
            f"{one_line(str(output))}: {found.rays:,} rays{invalid}, {found.rays_hit:,} "
            f"hit{hits}; {triangle_text(tracer.scene)}; {watch.text()}; {speed:g} Mrays/s"
        )


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


def _run(
    kind: str, tracer: Tracer, arguments: dict[str, Any], progress: Progress | None
) -> _Results:
    """Trace rays: call a query with its arguments, and collect what is written."""
    import numpy as np

    from raystream.ray_files.hit_store import Columns

    found = getattr(tracer, QUERIES[kind])(**arguments, progress=progress)
    if kind == "any":
        hit_count = int(np.count_nonzero(found))
        return _Results({"hit": found}, found.size, None, hit_count, hit_count)
    if kind == "count":
        return _Results(
            {"count": found}, found.size, None, int(np.count_nonzero(found)), int(found.sum())
        )
    if kind == "multi":
        rays_hit, hit_count = int(np.count_nonzero(found.counts)), len(found.t)
    else:
        rays_hit = hit_count = int(np.count_nonzero(found.is_hit))
    columns = Columns.of(QUERIES[kind], tracer.structure.triangles)  # those of a Zarr store
    arrays = {name: getattr(found, name) for name in (*columns.of_rows, *columns.of_rays)}
    invalid_count = int(np.count_nonzero(found.status))
    return _Results(arrays, found.status.size, invalid_count, rays_hit, hit_count)
