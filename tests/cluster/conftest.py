"""A cluster of two processes with a thread each, for all tests here."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import raystream as rs
from extras import need


@pytest.fixture(scope="session")
def local_cluster() -> Callable[[], Any]:
    """Makes clusters of two workers."""
    need("distributed")
    import distributed

    return lambda: distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        worker_dashboard_address="127.0.0.1:0",
        silence_logs=logging.CRITICAL,
    )


@pytest.fixture(scope="session")
def cluster(local_cluster) -> Iterator[Any]:
    with local_cluster() as cluster:
        yield cluster


@pytest.fixture(scope="session")
def client(cluster) -> Iterator[Any]:
    from distributed import Client

    with Client(cluster) as client:
        yield client


@pytest.fixture(scope="session")
def room() -> rs.Scene:
    return rs.load("cornell")
