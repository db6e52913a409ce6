"""Kernels of the multipass machine with example arguments, for compilation without a device."""

from __future__ import annotations

from typing import Any

import numpy as np

from raystream.cuda.multipass.control import rules_of
from raystream.cuda.multipass.kernels import rays
from raystream.cuda.multipass.kernels.choose import DECIDE, DECIDE_IN_LOOP
from raystream.cuda.multipass.passes import pass_of
from raystream.jit.constants import NULL
from raystream.jit.cuda import RangeKernel
from raystream.kernels.hits import HitAddresses
from raystream.kernels.ray_source import RaySource
from raystream.machines.records import SHADE_HITS, StepArguments
from raystream.machines.schedulers import DEFAULT_THRESHOLD
from raystream.machines.steps import steps_of
from raystream.scene.scene import Scene
from raystream.structures import build_structure

__all__ = ["multipass_kernels"]


def multipass_kernels(
    name: str, scene: Scene, **options: Any
) -> dict[str, tuple[RangeKernel, tuple[Any, ...]]]:
    """The kernels for a structure, with placeholder arguments of the right types.

    Parameters
    ----------
    name : str
        The structure's.
    scene : Scene
        The structure is built for it; any scene will do.
    **options
        Of the structure.

    Returns
    -------
    dict
        Kernels by name. All but the passes are the same for every structure.
    """
    structure = build_structure(name, scene.triangles, **options)
    steps = steps_of(structure)
    source = RaySource(NULL, NULL, False, NULL, NULL, False, NULL, NULL, NULL, NULL)
    hits = HitAddresses(NULL, NULL, NULL, NULL)
    wanted, streams = rays.Wanted(NULL, NULL), rays.RayStreamAddresses(*(NULL,) * 7)
    query = StepArguments(np.float32(1.0), True, SHADE_HITS, hits, *(NULL,) * 6)
    rules = rules_of(steps.kernels, "threshold", DEFAULT_THRESHOLD, compacts=False)
    return {
        "pass": (pass_of(steps), (*(NULL,) * 8, steps.tree, query)),
        "counting pass": (pass_of(steps), (*(NULL,) * 8, steps.tree, query._replace(hits=None))),
        "decide": (DECIDE, (NULL, rules)),
        "decide in loop": (DECIDE_IN_LOOP, (NULL, rules, NULL)),
        "begin": (rays.BEGIN, (source, structure.frame, streams, wanted, NULL)),
        "finish": (rays.FINISH, (streams, hits)),
        "finish many": (rays.FINISH_MANY, (streams, wanted, hits)),
        "count kept": (rays.COUNT_KEPT, (NULL,) * 4),
        "keep": (rays.KEEP, (NULL,) * 5),
    }
