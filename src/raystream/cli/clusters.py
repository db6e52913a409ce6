"""Dask clusters on the command line: ``raystream render --cluster``."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from raystream.cli.console import BadInputError, refuse

if TYPE_CHECKING:
    from distributed import Client

    from raystream.rendering.image import Image
    from raystream.tracer import Tracer

__all__ = ["Cluster", "ImageRenderer", "check_cluster", "cluster_client"]

LOCAL = "local:"

Cluster = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        metavar="ADDRESS",
        show_default=False,
        help="Render on the workers of a Dask cluster: the address of its scheduler, such as "
        "tcp://127.0.0.1:8786; or local:2 for two workers on this machine. The image is "
        "identical to the bit.",
    ),
]


def check_cluster(cluster: str | None, threads: int | None) -> None:
    """Reject ``--threads`` when it would have no effect."""
    if cluster is not None and threads is not None and not cluster.startswith(LOCAL):
        raise BadInputError("--threads: has no effect on a running cluster's workers; omit it")


@contextlib.contextmanager
def cluster_client(cluster: str | None, threads: int | None = None) -> Iterator[Client | None]:
    """Connect to a cluster during the block; None without one.

    Parameters
    ----------
    cluster : str or None
        Value of ``--cluster``.
    threads : int, optional
        Threads of each worker started here.

    Raises
    ------
    BadInputError
        If the address is malformed, or Dask is not installed.
    ClusterError
        If the scheduler does not answer.
    """
    if cluster is None:
        yield None
        return
    with refuse(ImportError, where="--cluster"):
        import raystream.cluster as cluster_api

        _ = cluster_api.render
    from raystream.cluster.clients import client_of, close

    with refuse(ValueError, where="--cluster"):
        client = client_of(cluster, threads=threads)
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
    structure : str or None
    device : str
    chosen : mapping
        Tracer options.
    """

    client: Client | None
    structure: str | None
    device: str
    chosen: Mapping[str, Any]

    @property
    def builds_on_workers(self) -> bool:
        """Whether workers build the structure, on a device that this machine may lack."""
        return self.client is not None and self.device != "cpu"

    def structure_name(self, tracer: Tracer) -> str:
        """Name the structure that traces the image, here or on the workers."""
        return (self.structure or "bvh") if self.builds_on_workers else tracer.structure.name

    def __call__(self, tracer: Tracer, mode: str, **arguments: Any) -> Image:
        """Render with the arguments of `raystream.render`."""
        if self.client is None:
            from raystream.rendering.render import render

            return render(tracer, mode, **arguments)
        import raystream.cluster as cluster_api

        if not self.builds_on_workers:
            return cluster_api.render(tracer, mode, client=self.client, **arguments)
        own = {"structure": self.structure or "bvh", "device": self.device, **self.chosen}
        return cluster_api.render(tracer.scene, mode, client=self.client, **own, **arguments)
