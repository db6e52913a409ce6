"""Clusters on the command line: ``raystream render --cluster``."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from raystream.cli.messages import BadInputError, refuse

if TYPE_CHECKING:
    from distributed import Client

    from raystream.rendering.image import Image
    from raystream.tracer import Tracer

__all__ = ["Cluster", "Rendering", "check_cluster", "joined"]

LOCAL = "local:"

Cluster = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        metavar="ADDRESS",
        show_default=False,
        help="Have the workers of a Dask cluster render: the address of its scheduler, such as "
        "tcp://127.0.0.1:8786; or local:2, two workers of this machine. The picture is the same, "
        "to the bit.",
    ),
]


def check_cluster(cluster: str | None, threads: int | None) -> None:
    """Refuse ``--threads`` where it has no say."""
    if cluster is not None and threads is not None and not cluster.startswith(LOCAL):
        raise BadInputError("--threads: a cluster's workers have threads of their own; leave it")


@contextlib.contextmanager
def joined(cluster: str | None, threads: int | None = None) -> Iterator[Client | None]:
    """The client of a cluster while the block runs; None without one.

    Parameters
    ----------
    cluster : str or None
        What ``--cluster`` was given.
    threads : int, optional
        Of each worker that is started here.

    Raises
    ------
    BadInputError
        If it is no address, or Dask is not installed.
    ClusterError
        If nobody answers there.
    """
    if cluster is None:
        yield None
        return
    with refuse(ImportError, where="--cluster"):
        import raystream.cluster as room

        _ = room.render
    from raystream.cluster.clients import client_of, close

    with refuse(ValueError, where="--cluster"):
        client = client_of(cluster, threads=threads)
    try:
        yield client
    finally:
        close(client)


@dataclass(frozen=True)
class Rendering:
    """Who renders a picture: this process, or a cluster.

    Attributes
    ----------
    client : distributed.Client or None
    structure : str or None
    device : str
    chosen : mapping
        Options of the tracer.
    """

    client: Client | None
    structure: str | None
    device: str
    chosen: Mapping[str, Any]

    @property
    def builds_elsewhere(self) -> bool:
        """Whether workers build the structure, on a device that this machine may not have."""
        return self.client is not None and self.device != "cpu"

    def structure_of(self, tracer: Tracer) -> str:
        """What traces the picture: this machine's tracer, or one of the workers'."""
        return (self.structure or "bvh") if self.builds_elsewhere else tracer.structure.name

    def __call__(self, tracer: Tracer, mode: str, **arguments: Any) -> Image:
        """Render, as `raystream.render` with these arguments."""
        if self.client is None:
            from raystream.rendering.picture import render

            return render(tracer, mode, **arguments)
        import raystream.cluster as room

        if not self.builds_elsewhere:
            return room.render(tracer, mode, client=self.client, **arguments)
        own = {"structure": self.structure or "bvh", "device": self.device, **self.chosen}
        return room.render(tracer.scene, mode, client=self.client, **own, **arguments)
