"""Options of the CUDA device's machines; importable without CUDA's packages."""

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

#: How threads get rays: one thread per ray, or persistent warps that fetch rays.
LAUNCHES = ("range", "persistent")

#: The order in which threads take rays; see `ray_order`.
ORDERS = ("given", "sorted")

_NAMES: Mapping[str, Sequence[str]] = MappingProxyType({"launch": LAUNCHES, "order": ORDERS})


def check_names(options: Mapping[str, Any]) -> None:
    """Check the options that are names; others are ignored.

    Raises
    ------
    ValueError
        If a launch or order is unknown.
    """
    for option, names in _NAMES.items():
        if options.get(option, names[0]) not in names:
            known = ", ".join(map(repr, names))
            raise ValueError(f"{option}: expected one of {known}, got {options[option]!r}")
