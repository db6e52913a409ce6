"""``raystream info --devices``: where rays can be traced here."""

from __future__ import annotations

from typing import Any

from raystream.cli.messages import one_line, write_json, write_line
from raystream.cli.tables import set_table

__all__ = ["show_devices"]

#: What an adapter's limits mean for a scene or a picture, by wgpu's names.
LIMITS = {
    "max-buffer-size": "buffer",
    "max-storage-buffer-binding-size": "array",
    "max-texture-dimension-2d": "texture side",
}


def show_devices(json: bool) -> None:
    """Print the processor and the graphics adapters, or why there are none."""
    figures = {"cpu": _processor(), "graphics": _graphics()}
    if json:
        write_json(figures)
        return
    cpu, graphics = figures["cpu"], figures["graphics"]
    facts = [("cpu", cpu["name"]), ("  threads", cpu["threads"])]
    if cpu["features"]:
        facts.append(("  vectors", " ".join(cpu["features"])))
    write_line(set_table(["", ""], facts))
    write_line()
    if graphics["adapters"]:
        columns = ["graphics adapter", "kind", "backend", "driver", *LIMITS.values(), ""]
        write_line(set_table(columns, [_row(one) for one in graphics["adapters"]]))
    if graphics["error"]:
        write_line(f"no graphics: {graphics['error']}")


def _processor() -> dict[str, Any]:
    from raystream.bench.machine import describe_machine
    from raystream.jit.threads import thread_count

    machine = describe_machine(thread_count())
    return {name: machine[key] for name, key in _PROCESSOR.items()}


#: What is told of the processor, by the names of `bench.machine`.
_PROCESSOR = {"name": "cpu", "cores": "cores", "threads": "threads", "features": "features"}


def _graphics() -> dict[str, Any]:
    from raystream.graphics.adapters import Adapter, adapters, choose_adapter
    from raystream.graphics.errors import GraphicsError

    found: list[Adapter] = []
    usual: Adapter | None = None
    reason: str | None = None
    try:
        found = adapters()
        usual = choose_adapter()
    except GraphicsError as error:
        reason = one_line(str(error))
    listed = [
        {
            "name": one_line(one.name),
            "kind": "software" if one.is_software else one.kind,
            "backend": one.backend,
            "driver": one_line(one.description),
            "limits": {limit: int(one.handle.limits[limit]) for limit in LIMITS},
            "is_usual": str(one) == str(usual),
        }
        for one in found
    ]
    return {"adapters": listed, "error": reason}


def _row(adapter: dict[str, Any]) -> tuple[str, ...]:
    from rich.filesize import decimal

    limits = adapter["limits"]
    shown = [
        f"{limits[name]:,}" if "dimension" in name else decimal(limits[name]) for name in LIMITS
    ]
    usual = "taken without --adapter" if adapter["is_usual"] else ""
    return *(adapter[name] for name in ("name", "kind", "backend", "driver")), *shown, usual
