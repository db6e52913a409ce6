"""ClusterError: failures of a cluster."""

from __future__ import annotations

from raystream.core.errors import RaystreamError


class ClusterError(RaystreamError, RuntimeError):
    """A cluster is unreachable, has no workers, loses them repeatedly, or mixes versions."""
