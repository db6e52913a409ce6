"""``raystream info --devices``: list the devices that can trace rays."""

from __future__ import annotations

from typing import Any

from raystream.cli.console import one_line, write_json, write_line
from raystream.cli.tables import format_table

#: Adapter limits that bound a scene or an image, by wgpu's names.
LIMITS = {
    "max-buffer-size": "buffer",
    "max-storage-buffer-binding-size": "array",
    "max-texture-dimension-2d": "texture side",
}


def show_devices(json: bool) -> None:
    """Print the processor, the graphics adapters and the CUDA GPUs, or why one is unavailable."""
    figures = {"cpu": _processor(), "graphics": _graphics(), "cuda": _cuda()}
    if json:
        write_json(figures)
        return
    cpu, graphics = figures["cpu"], figures["graphics"]
    facts = [("cpu", cpu["name"]), ("  threads", cpu["threads"])]
    if cpu["features"]:
        facts.append(("  vectors", " ".join(cpu["features"])))
    write_line(format_table(["", ""], facts))
    write_line()
    if graphics["adapters"]:
        columns = ["graphics adapter", "kind", "backend", "driver", *LIMITS.values(), ""]
        write_line(format_table(columns, [_row(one) for one in graphics["adapters"]]))
    if graphics["error"]:
        write_line(f"no graphics: {graphics['error']}")
    _show_cuda(figures["cuda"])


def _show_cuda(cuda: dict[str, Any]) -> None:
    from rich.filesize import decimal

    if cuda["error"]:
        write_line(f"no CUDA: {cuda['error']}")
        return
    write_line()
    rows = [
        (
            one["number"],
            one["name"],
            one["capability"] or "",
            decimal(one["memory"]) if one["memory"] else "",
            one["error"] or "",
        )
        for one in cuda["gpus"]
    ]
    driver = f", driver for CUDA {cuda['driver']}" if cuda["driver"] else ""
    columns = ["gpu", f"CUDA GPU{driver}", "capability", "memory", "not usable"]
    write_line(format_table(columns if any(row[-1] for row in rows) else [*columns[:-1], ""], rows))


def _processor() -> dict[str, Any]:
    from raystream.bench.machine import describe_machine
    from raystream.jit.threads import thread_count

    machine = describe_machine(thread_count())
    return {name: machine[key] for name, key in _PROCESSOR.items()}


#: Printed figures of the processor, with the names of `bench.machine`.
_PROCESSOR = {"name": "cpu", "cores": "cores", "threads": "threads", "features": "features"}


def _graphics() -> dict[str, Any]:
    from raystream.graphics.adapters import Adapter, adapters, choose_adapter
    from raystream.graphics.errors import GraphicsError

    found: list[Adapter] = []
    default: Adapter | None = None
    reason: str | None = None
    try:
        found = adapters()
        default = choose_adapter()
    except GraphicsError as error:
        reason = one_line(str(error))
    listed = [
        {
            "name": one_line(one.name),
            "kind": "software" if one.is_software else one.kind,
            "backend": one.backend,
            "driver": one_line(one.description),
            "limits": {limit: int(one.handle.limits[limit]) for limit in LIMITS},
            "is_default": str(one) == str(default),
        }
        for one in found
    ]
    return {"adapters": listed, "error": reason}


def _cuda() -> dict[str, Any]:
    from raystream.core.errors import RaystreamError
    from raystream.cuda.devices import list_gpus

    try:
        found, driver = list_gpus()
    except RaystreamError as error:
        return {"gpus": [], "driver": None, "error": one_line(str(error))}
    listed = [
        {
            "number": one.number,
            "name": one_line(one.name),
            "capability": _version(one.capability),
            "memory": one.byte_count,
            "error": None if one.error is None else one_line(one.error),
        }
        for one in found
    ]
    return {"gpus": listed, "driver": _version(driver), "error": None}


def _version(numbers: tuple[int, int] | None) -> str | None:
    return None if numbers is None else ".".join(map(str, numbers))


def _row(adapter: dict[str, Any]) -> tuple[str, ...]:
    from rich.filesize import decimal

    limits = adapter["limits"]
    shown = [
        f"{limits[name]:,}" if "dimension" in name else decimal(limits[name]) for name in LIMITS
    ]
    default = "default" if adapter["is_default"] else ""
    return *(adapter[name] for name in ("name", "kind", "backend", "driver")), *shown, default
