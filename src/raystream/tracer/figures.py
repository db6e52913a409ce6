"""The figures of a structure that notebooks show."""

from __future__ import annotations

from collections.abc import Sequence

from raystream.notebook import in_bytes
from raystream.structures.base import Structure


def figures_of(structure: Structure, places: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    """Names and values of a structure, with where it is traced before what it takes."""
    triangles, report = structure.triangles, structure.report
    unused = (
        (triangles.degenerate_count, "degenerate"),
        (triangles.nonfinite_count, "not finite"),
    )
    without = ", ".join(f"{count:,} {kind}" for count, kind in unused if count)
    options = structure.options.as_json().items()
    return [
        ("triangles", f"{len(triangles):,}" + (f" ({without})" if without else "")),
        ("structure", structure.name),
        *((f"  {name}", f"{value}") for name, value in options if value is not None),
        *places,
        ("build", f"{report.seconds:.3g} s"),
        ("memory", in_bytes(report.byte_count)),
        *((name, f"{value:,.6g}") for name, value in structure.quality().items()),
    ]
