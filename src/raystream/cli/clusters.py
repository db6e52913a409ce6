"""Dask clusters on the command line: ``raystream render --cluster``."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

from raystream.cli import options
from raystream.cli.console import BadInputError, refuse
from raystream.cli.options import Threads
from raystream.cli.tracer_options import TracerArguments

if TYPE_CHECKING:
    from distributed import Client

    from raystream.rendering.image import Image
    from raystream.tracer import Tracer

LOCAL = "local:"


@dataclass(frozen=True)
class ClusterOptions:
    """Options of where an image is rendered."""

    cluster: Annotated[
        str | None,
        options.value(
            "ADDRESS",
            "Render on the workers of a Dask cluster: the address of its scheduler, such as "
            "tcp://127.0.0.1:8786; or local:2 for two workers on this machine. The image is "
            "the same, bit for bit.",
        ),
    ] = None
    threads: Threads = None

    def check(self) -> None:
        """Reject ``--threads`` when it would have no effect."""
        cluster = self.cluster
        if cluster is not None and self.threads is not None and not cluster.startswith(LOCAL):
            raise BadInputError("--threads: has no effect on a running cluster's workers; omit it")

    @contextlib.contextmanager
    def client(self) -> Iterator[Client | None]:
        """Connect to the cluster during the block; None without one.

        Raises
        ------
        BadInputError
            If the address is malformed, or Dask is not installed.
        ClusterError
            If the scheduler does not answer.
        """
        if self.cluster is None:
            yield None
            return
        with refuse(ImportError, where="--cluster"):
            import raystream.cluster as cluster_api

            _ = cluster_api.render
        from raystream.cluster.clients import client_of, close

        with refuse(ValueError, where="--cluster"):
            client = client_of(self.cluster, threads=self.threads)
        try:
            yield client
        finally:
            close(client)


@dataclass(frozen=True)
class ImageRenderer:
    """Renders an image in this process or on a cluster.

    Attributes
    ----------
    client : distributed.Client or None
    chosen : TracerArguments
    """

    client: Client | None
    chosen: TracerArguments

    @property
    def builds_on_workers(self) -> bool:
        """Whether workers build the structure, on a device that this machine may lack."""
        return self.client is not None and self.chosen.device != "cpu"

    def structure_name(self, tracer: Tracer) -> str:
        """Name the structure that traces the image, here or on the workers."""
        return (self.chosen.structure or "bvh") if self.builds_on_workers else tracer.structure.name

    def __call__(self, tracer: Tracer, mode: str, **arguments: Any) -> Image:
        """Render with the arguments of `raystream.render`."""
        if self.client is None:
            from raystream.rendering.render import render

            return render(tracer, mode, **arguments)
        import raystream.cluster as cluster_api

        if not self.builds_on_workers:
            return cluster_api.render(tracer, mode, client=self.client, **arguments)
        arguments |= self.chosen.keywords()
        return cluster_api.render(tracer.scene, mode, client=self.client, **arguments)
