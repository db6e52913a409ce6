"""Options of the CUDA device's machines; importable without CUDA's packages."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from raystream.machines import MULTIPASS_OPTIONS

__all__ = ["OPTIONS"]

_SHARED = ("gpu", "rays_at_once")

#: Options of each machine.
OPTIONS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "branching": _SHARED,
        "multipass": (*_SHARED, *MULTIPASS_OPTIONS, "loop", "max_passes"),
    }
)
