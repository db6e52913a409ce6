"""Options of the CUDA tracer that are names; known without CUDA's packages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from raystream.machines import MULTIPASS_OPTIONS

__all__ = ["LAUNCHES", "OPTIONS", "ORDERS", "check_names"]

_SHARED = ("gpu", "rays_at_once")

#: Options of each machine.
OPTIONS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "branching": (*_SHARED, "kernel", "launch", "order"),
        "multipass": (*_SHARED, *MULTIPASS_OPTIONS, "loop", "max_passes"),
    }
)

#: How threads get their rays: each one of a range, or whenever a warp is done with the last ones.
LAUNCHES = ("range", "persistent")

#: Which rays the threads of a warp take: those that were given one after the other, or those that
#: are alike.
ORDERS = ("given", "sorted")

_NAMES: Mapping[str, Sequence[str]] = MappingProxyType({"launch": LAUNCHES, "order": ORDERS})


def check_names(options: Mapping[str, Any]) -> None:
    """Refuse names that are unknown; options that are not among these are left alone.

    Raises
    ------
    ValueError
        If there is no launch or order of that name.
    """
    for option, names in _NAMES.items():
        if options.get(option, names[0]) not in names:
            known = ", ".join(map(repr, names))
            raise ValueError(f"{option}: expected one of {known}, got {options[option]!r}")
