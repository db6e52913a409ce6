"""``raystream info``: contents of a scene, and figures of its structure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from raystream.cli import options
from raystream.cli.bars import Bars
from raystream.cli.compiling import compiling
from raystream.cli.console import BadInputError, write_json, write_line
from raystream.cli.devices import show_devices
from raystream.cli.load import Stopwatch, choose_threads, open_tracer
from raystream.cli.option_groups import expand_groups
from raystream.cli.tables import format_table
from raystream.cli.tracer_options import TracerOptions

#: Maximum rows of meshes and materials on the console; ``--json`` lists all.
MAX_ROWS = 12

_VECTORS = ("eye", "look_at", "up")


@expand_groups
def info(
    scene: Annotated[str | None, options.SCENE] = None,
    *,
    tracing: TracerOptions,
    threads: options.Threads = None,
    loading: options.SceneOptions,
    devices: Annotated[
        bool, options.flag("--devices", "List the available devices; takes no SCENE.")
    ] = False,
    json: options.Json = False,
) -> None:
    """Show the contents of a scene. Also shows its structure's build time, memory and quality."""
    if devices == (scene is not None):
        raise BadInputError("info: expected either SCENE or --devices")
    chosen = tracing.arguments()
    choose_threads(threads)
    if scene is None:
        show_devices(json)
        return
    from raystream.cli.describe import describe

    watch = Stopwatch()
    with Bars() as bars, compiling("build-balanced", chosen, watch):
        tracer = open_tracer(scene, loading, chosen, bars, watch)
        figures = describe(scene, tracer, watch)
    if json:
        write_json({**figures, **chosen.figures()})
    else:
        _show(figures)


def _show(figures: dict[str, Any]) -> None:
    meshes = [
        (i, mesh["name"], mesh["triangles"], mesh["vertices"], " ".join(mesh["attributes"]))
        for i, mesh in enumerate(figures["meshes"])
    ]
    materials = [
        (
            i,
            material["name"],
            material["triangles"],
            _vector(material["diffuse"]),
            " ".join(material["textures"].values()),
        )
        for i, material in enumerate(figures["materials"])
    ]
    write_line(format_table(["", ""], _facts(figures)))
    if meshes:
        write_line()
        write_line(_largest("meshes", ["id", "mesh", "triangles", "vertices", "has"], meshes))
    write_line()
    columns = ["id", "material", "triangles", "diffuse", "textures"]
    write_line(_largest("materials", columns, materials))


def _camera_parts(camera: dict[str, Any]) -> list[str]:
    """Format the camera as options of ``render``; projection and lens only if not default."""
    parts = [f"--{part.replace('_', '-')} {_vector(camera[part])}" for part in _VECTORS]
    parts.append(f"--fov {camera['fov']:g}")
    if camera["projection"] != "perspective":
        parts.append(f"--projection {camera['projection']}")
    lengths = {"height": "view-height", "aperture": "aperture", "focus": "focus"}
    return parts + [f"--{name} {camera[part]:g}" for part, name in lengths.items() if camera[part]]


def _facts(figures: dict[str, Any]) -> list[tuple[str, str]]:
    """Collect the scene's single figures, by name."""
    from rich.filesize import decimal

    bounds, camera = figures["bounds"], figures["camera"]
    memory, structure = figures["memory"], figures["structure"]
    lights = [light["type"] for light in figures["lights"]]
    kinds = [f"{lights.count(kind):,} {kind}" for kind in dict.fromkeys(lights)]
    return [
        ("scene", figures["scene"]),
        ("name", figures["name"]),
        ("triangles", f"{figures['triangles']:,}"),
        ("  degenerate", f"{figures['degenerate_triangles']:,}"),
        ("  non-finite", f"{figures['nonfinite_triangles']:,}"),
        ("vertices", f"{figures['vertices']:,}"),
        *_instance_facts(figures),
        ("meshes", f"{len(figures['meshes']):,}"),
        *_solid_facts(figures),
        ("materials", f"{len(figures['materials']):,}"),
        ("lights", ", ".join(kinds) or "none"),
        ("low corner", _vector(bounds["low"]) if bounds else "nothing can be hit"),
        ("high corner", _vector(bounds["high"]) if bounds else ""),
        ("camera", " ".join(_camera_parts(camera))),
        ("memory", " + ".join(f"{decimal(size)} {name}" for name, size in memory.items())),
        ("load", f"{figures['seconds']['load']:.2f} s"),
        ("structure", f"{structure['name']}, built in {structure['seconds']:.2f} s"),
        *((f"  {name}", f"{value:,.6g}") for name, value in structure["quality"].items()),
    ]


def _instance_facts(figures: dict[str, Any]) -> list[tuple[str, str]]:
    if "instances" not in figures:
        return []
    count = f"{figures['instances']:,}, of {figures['instanced_triangles']:,} triangles"
    return [("instances", count)]


def _solid_facts(figures: dict[str, Any]) -> list[tuple[str, str]]:
    """Say whether the surface is closed; `contains` and `signed_distance` need that."""
    if "is_closed" not in figures or not figures["meshes"]:
        return []
    count, closed = len(figures["meshes"]), sum(mesh["is_closed"] for mesh in figures["meshes"])
    if closed == count:
        return [("  closed", "all" if count > 1 else "yes")]
    alone = f"{closed:,} of {count:,}" if count > 1 else "no"
    return [("  closed", f"{alone}; together they are" if figures["is_closed"] else alone)]


def _vector(numbers: Sequence[float], separator: str = " ") -> str:
    return separator.join(f"{number:.6g}" for number in numbers)


def _largest(what: str, columns: Sequence[str], rows: Sequence[tuple[Any, ...]]) -> str:
    """Format the rows with the most triangles (the third column)."""
    shown = sorted(rows, key=lambda row: -row[2])[:MAX_ROWS]
    text = format_table(columns, shown)
    if len(rows) > len(shown):
        text += f"\nand {len(rows) - len(shown):,} more {what} (--json lists all)"
    return text
