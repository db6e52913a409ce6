"""Client connections to a Dask cluster."""

from __future__ import annotations

import contextlib
import logging
import os
import re
import signal
from collections.abc import Iterator

from distributed import Client, LocalCluster, Worker, WorkerPlugin, default_client

from raystream.cluster.errors import ClusterError

#: Seconds to wait for the first worker.
TIMEOUT = 30.0

#: More local workers than this are treated as a mistake.
MAX_LOCAL = 1024

_LOCAL = re.compile(r"local:(\d+)", re.ASCII)


def client_of(
    client: Client | str | None, is_default: bool = False, threads: int | None = None
) -> Client:
    """Return an existing client, or connect one to an address.

    Parameters
    ----------
    client : distributed.Client, str, or None
        None is the most recently opened client. A string is a scheduler's address, such as
        ``"tcp://127.0.0.1:8786"``, or ``"local:2"``: two workers started on this machine.
    is_default : bool
        Whether a client opened here becomes the default for Dask's ``compute``.
    threads : int, optional
        Threads of each worker started here. Default: the cores divided among them.

    Raises
    ------
    ClusterError
        If there is no client, or the scheduler does not answer.
    ValueError
        If the string is not an address.
    TypeError
        If it is another type, or an asynchronous client.
    """
    if client is None:
        try:
            client = default_client()
        except ValueError:
            raise ClusterError(
                "client: none is open; create one with distributed.Client(...), or pass the "
                'address of a scheduler, or "local:2" for two workers on this machine'
            ) from None
    if isinstance(client, str):
        client = _connected(client, is_default, threads)
    if not isinstance(client, Client):
        raise TypeError(
            f"client: expected a distributed.Client or an address, got {type(client).__name__}"
        )
    if client.asynchronous:
        raise TypeError("client: expected a synchronous client, not asynchronous=True")
    if client.status != "running":
        raise ClusterError("client: its connection is closed; create a new one")
    return client


@contextlib.contextmanager
def open_client(client: Client | str | None) -> Iterator[Client]:
    """Like `client_of`, but closes a client opened here on exit."""
    is_own = isinstance(client, str)
    found = client_of(client)
    try:
        yield found
    finally:
        if is_own:
            close(found)


def close(client: Client) -> None:
    """Close a connection, and stop the workers started for it."""
    cluster = client.cluster
    with contextlib.suppress(OSError, TimeoutError):
        client.close()
        if cluster is not None:
            cluster.close()


def thread_total(client: Client) -> int:
    """Return the thread count of all workers; waits for the first worker.

    Raises
    ------
    ClusterError
        If no worker appears, or the scheduler does not answer.
    """
    try:
        if not client.nthreads():
            client.wait_for_workers(1, timeout=TIMEOUT)
        return max(1, sum(client.nthreads().values()))
    except TimeoutError:
        raise ClusterError(
            f"the cluster has no workers: start some with 'dask worker {_address(client)}'"
        ) from None
    except (OSError, ValueError) as error:
        raise ClusterError(f"the cluster's scheduler does not answer: {error}") from error


def _address(client: Client) -> str:
    scheduler = client.scheduler
    return "ADDRESS" if scheduler is None else str(scheduler.address)


def _connected(address: str, is_default: bool, threads: int | None) -> Client:
    local = _LOCAL.fullmatch(address)
    if local is not None:
        return _local(int(local[1]), is_default, threads)
    if not re.fullmatch(r"[a-z]+://[^/\s]+", address, re.ASCII):
        raise ValueError(
            f"client: expected an address, such as tcp://127.0.0.1:8786, or local:2; got "
            f"{address!r:.80}"
        )
    try:
        return Client(address, timeout=TIMEOUT / 3.0, set_as_default=is_default)
    except (OSError, ValueError, ImportError) as error:
        raise ClusterError(f"{address}: no Dask scheduler answers ({error})") from error


def _local(count: int, is_default: bool, threads: int | None) -> Client:
    """Start workers on this machine that share its cores and listen on loopback only."""
    if not 1 <= count <= MAX_LOCAL:
        raise ValueError(f"client: expected local:1 to local:{MAX_LOCAL}, got local:{count}")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    cluster = LocalCluster(
        n_workers=count,
        threads_per_worker=threads or max(1, (cores or 1) // count),
        processes=True,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        worker_dashboard_address="127.0.0.1:0",
        silence_logs=logging.CRITICAL,
    )
    client = Client(cluster, set_as_default=is_default)
    client.register_plugin(_IgnoreInterrupts())
    return client


class _IgnoreInterrupts(WorkerPlugin):
    """Workers ignore Ctrl-C, which a terminal sends to all its processes; the client decides."""

    name = "raystream-interrupts"

    def setup(self, worker: Worker) -> None:  # noqa: ARG002
        with contextlib.suppress(ValueError):  # not the main thread
            signal.signal(signal.SIGINT, signal.SIG_IGN)
