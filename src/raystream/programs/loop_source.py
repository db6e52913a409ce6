"""Source of the loops around a user's function, for the CPU and CUDA."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from raystream.jit.intrinsics import row_of
from raystream.jit.user_results import accept_decision
from raystream.programs.decisions import Decision
from raystream.programs.hits import (
    close_ray,
    columns_at,
    is_open,
    position_at,
    ray_at,
    row_range,
)
from raystream.programs.rows import add_one, keep_row, move_row, put_row
from raystream.programs.scene_forms import TRIANGLES, SceneForm

#: Use of hits: by a program with a record, or by a filter that keeps the nearest, counts, or keeps
#: all in order: compacted in place ("multi"), or copied to an output ("keep").
Goal = Literal["trace", "first", "count", "multi", "keep"]

#: Statements before the hits of a ray, at each one that is kept, and after them.
_STATEMENTS: dict[str, tuple[list[str], list[str], list[str]]] = {
    "trace": ([], [], []),
    "first": (
        [],
        ["put_row(out, ray, rows, row)", "close_ray(open_rays, position)", "break"],
        ["if start == row_end:", "    close_ray(open_rays, position)"],
    ),
    "count": ([], ["add_one(out, ray)"], []),
    "multi": (
        ["to = row"],
        [
            "move_row(rows, row, to)",
            "to += one",
            "found[ray] += 1",
            "if found[ray] == most:",
            "    close_ray(open_rays, position)",
            "    break",
        ],
        ["kept[i] = to - start"],
    ),
    "keep": (
        [],
        [
            "if keep_row(out, splits, found, ray, rows, row) == most:",
            "    close_ray(open_rays, position)",
            "    break",
        ],
        [],
    ),
}

_PARAMETERS = {
    "trace": ["payload"],
    "first": ["out"],
    "count": ["out"],
    "multi": ["found", "most", "kept"],
    "keep": ["found", "most", "splits", "out"],
}


def loop_source(
    goal: Goal, skips: bool, constants: bool, record: str, leave: str
) -> tuple[list[str], list[str]]:
    """Source of the loop over the rows of entry i; those visited are `start` to `row`.

    Parameters
    ----------
    goal : Goal
    skips, constants : bool
        Whether rays skip triangles, and whether the function takes constants.
    record : str
        Expression that reads the record of a payload.
    leave : str
        Statement that ends an entry.

    Returns
    -------
    names : list of str
        Its arguments, except the first, ``i``.
    lines : list of str
        Statements that use `loop_globals`, and the user's function as ``function``.
    """
    before, at_hit, after = _STATEMENTS[goal]
    more = f", {record}" if goal == "trace" else ""
    more += ", constants" if constants else ""
    names = ["rows", "rays", "scene", "open_rays"]
    names += [*(["skips"] if skips else []), *(["constants"] if constants else [])]
    names += _PARAMETERS[goal]
    skipped = ["if is_skipped(skips, ray, hit):", "    row += one", "    continue"]
    lines = [
        "position = position_at(rays, i)",
        "if not is_open(open_rays, position):",
        f"    {leave}",
        "ray = ray_at(rays, position)",
        "row, row_end = row_range(rows, i)",
        "start = row",
        *before,
        "while row != row_end:",
        "    t, u, v, prim_id = columns_at(rows, row)",
        "    hit = hit_of(ray, t, u, v, prim_id, rays, position, scene)",
        *([f"    {line}" for line in skipped] if skips else []),
        f"    decision = accept(function(hit{more}))",
        *([] if goal == "trace" else ["    if decision != ignore:"]),
        *(f"        {line}" for line in at_hit),
        "    row += one",
        "    if decision == stop:",
        "        close_ray(open_rays, position)",
        "        break",
        *after,
    ]
    return names, lines


def loop_globals(goal: Goal, form: SceneForm = TRIANGLES) -> dict[str, Any]:
    """Globals of the source, for a kind of scene."""
    return {
        "accept": accept_decision(Decision, goal != "trace"),
        "add_one": add_one,
        "close_ray": close_ray,
        "columns_at": form.of_rows(columns_at),
        "hit_of": form.hit_of,
        "ignore": np.int64(Decision.IGNORE),
        "is_open": is_open,
        "is_skipped": form.is_skipped,
        "keep_row": form.of_rows(keep_row),
        "move_row": form.of_rows(move_row),
        "one": np.uint64(1),
        "position_at": position_at,
        "put_row": form.of_rows(put_row),
        "ray_at": ray_at,
        "row_of": row_of,
        "row_range": row_range,
        "stop": np.int64(Decision.STOP),
        "unsigned": np.uint64,
        "zero": np.uint64(0),
    }
