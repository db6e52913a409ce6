"""The table "features by kind of scene", from the declarations.

``python tests/documentation/kinds_table.py`` writes it into ``docs/scenes.rst``.
"""

from __future__ import annotations

from pathlib import Path

from raystream.core.scene_kinds import FEATURES

PAGE = Path(__file__).parents[2] / "docs" / "scenes.rst"

#: Columns: kinds, and their heads.
COLUMNS = {
    "instances": "instances",
    "spheres": "spheres",
    "fields": "height fields",
    "shapes": "shapes",
    "float64": "float64",
    "placed spheres": "instances of spheres",
    "placed fields": "instances of height fields",
    "placed float64": "instances in float64",
}

BEGIN = ".. The table is written by tests/documentation/kinds_table.py.\n\n"
END = ".. Here it ends.\n"


def written() -> str:
    """The table as text, with the reasons of what is not supported below it."""
    lines = [
        ".. list-table::",
        "   :header-rows: 1",
        "   :widths: 28 9 9 9 9 9 9 9 9",
        "",
        "   * - feature",
        *(f"     - {head}" for head in COLUMNS.values()),
    ]
    reasons: dict[str, int] = {}
    for one in FEATURES.values():
        if not one.row:
            continue
        lines.append(f"   * - {one.row}")
        for kind in COLUMNS:
            if kind in one.kinds:
                lines.append(f"     - {one.notes.get(kind, 'yes')}")
            else:
                number = reasons.setdefault(one.reason, len(reasons) + 1)
                lines.append(f"     - no ({number})")
    if reasons:
        lines += ["", "Reasons:", ""]
        lines += [f"{number}. {reason}" for reason, number in reasons.items()]
    return "\n".join([*lines, "", ""])


def parts_of_page() -> tuple[str, str, str]:
    """The page before the table, the table, and the page behind it."""
    text = PAGE.read_text(encoding="utf-8")
    before, _, rest = text.partition(BEGIN)
    table, _, behind = rest.partition(END)
    return before + BEGIN, table, END + behind


if __name__ == "__main__":
    before, _, behind = parts_of_page()
    PAGE.write_text(before + written() + behind, encoding="utf-8")
