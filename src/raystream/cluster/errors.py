"""ClusterError: what goes wrong between machines."""

from __future__ import annotations

from raystream.core.errors import RaystreamError

__all__ = ["ClusterError"]


class ClusterError(RaystreamError, RuntimeError):
    """A cluster that cannot be reached, has no workers, lost them too often, or does not fit."""
