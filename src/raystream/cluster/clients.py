"""Clients: the connection to a cluster, from what a caller has of one."""

from __future__ import annotations

import contextlib
import logging
import os
import re
import signal
from collections.abc import Iterator

from distributed import Client, LocalCluster, Worker, WorkerPlugin, default_client

from raystream.cluster.errors import ClusterError

__all__ = ["client_of", "opened", "thread_total"]

#: Seconds to wait for the first worker.
PATIENCE = 30.0

#: More workers than this on one machine are taken for a mistake.
MAX_LOCAL = 1024

_LOCAL = re.compile(r"local:(\d+)", re.ASCII)


def client_of(
    client: Client | str | None, is_default: bool = False, threads: int | None = None
) -> Client:
    """A client that is there, or one for an address.

    Parameters
    ----------
    client : distributed.Client, str, or None
        None is the client that was opened last. A text is a scheduler's address, such as
        ``"tcp://127.0.0.1:8786"``, or ``"local:2"``: two workers on this machine, started now.
    is_default : bool
        Whether one for an address is to be the one that Dask's ``compute`` uses.
    threads : int, optional
        Of each worker that is started here; without it, they share the cores.

    Raises
    ------
    ClusterError
        If there is none, or nobody answers.
    ValueError
        If the text is no address.
    TypeError
        If it is something else, or an asynchronous client.
    """
    if client is None:
        try:
            client = default_client()
        except ValueError:
            raise ClusterError(
                "client: there is none yet; make one with distributed.Client(...), or give the "
                'address of a scheduler, or "local:2" for two workers on this machine'
            ) from None
    if isinstance(client, str):
        client = _connected(client, is_default, threads)
    if not isinstance(client, Client):
        raise TypeError(
            f"client: expected a distributed.Client or an address, got {type(client).__name__}"
        )
    if client.asynchronous:
        raise TypeError("client: expected one that waits for answers, not asynchronous=True")
    if client.status != "running":
        raise ClusterError("client: its connection is closed; make a new one")
    return client


@contextlib.contextmanager
def opened(client: Client | str | None) -> Iterator[Client]:
    """As `client_of`, and close at the end what was opened for it."""
    is_own = isinstance(client, str)
    found = client_of(client)
    try:
        yield found
    finally:
        if is_own:
            close(found)


def close(client: Client) -> None:
    """End a connection, and the workers that were started for it."""
    cluster = client.cluster
    with contextlib.suppress(OSError, TimeoutError):
        client.close()
        if cluster is not None:
            cluster.close()


def thread_total(client: Client) -> int:
    """Threads of all workers; waits for the first worker.

    Raises
    ------
    ClusterError
        If none comes, or the scheduler does not answer.
    """
    try:
        if not client.nthreads():
            client.wait_for_workers(1, timeout=PATIENCE)
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
        return Client(address, timeout=PATIENCE / 3.0, set_as_default=is_default)
    except (OSError, ValueError, ImportError) as error:
        raise ClusterError(f"{address}: no Dask scheduler answers there ({error})") from error


def _local(count: int, is_default: bool, threads: int | None) -> Client:
    """Workers of this machine, which share its cores, seen by nobody else."""
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
    client.register_plugin(_LeaveInterrupts())
    return client


class _LeaveInterrupts(WorkerPlugin):
    """Ctrl-C in a terminal goes to all processes in it: what is to be done, this one says."""

    name = "raystream-interrupts"

    def setup(self, worker: Worker) -> None:  # noqa: ARG002
        with contextlib.suppress(ValueError):  # not the main thread
            signal.signal(signal.SIGINT, signal.SIG_IGN)
