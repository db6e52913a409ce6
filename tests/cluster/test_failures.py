"""Workers that die, join late, or are missing: no work is lost."""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from extras import need

need("distributed")

import raystream as rs
from conftest import assert_same_bits
from raystream.cluster import clients
from raystream.cluster import tasks as cluster_tasks
from raystream.cluster.errors import ClusterError
from raystream.cluster.tasks import OrderedTasks

pytestmark = [
    pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="kills with SIGKILL"),
    # A busy machine takes more than 10 seconds to start others.
    pytest.mark.filterwarnings("ignore:the cluster has no workers left"),
]

ASKED = {"mode": "ao", "size": (96, 72), "samples": 24}


@pytest.fixture
def mortals(local_cluster):
    """A client with its own workers: those that die in quick succession may not come back."""
    from distributed import Client

    with local_cluster() as cluster, Client(cluster, set_as_default=False) as client:
        yield client


def wait_for(client, count):
    client.wait_for_workers(count, timeout=60)


def pids_of(client):
    """The workers' processes."""
    return list(client.run(os.getpid, on_error="ignore").values())


def kill_at(parts, client):
    """A progress callback that kills a worker whenever a part of the image is done."""
    left = list(parts)

    def look(done, total):
        if left and done >= left[0] * total:
            left.pop(0)
            for pid in pids_of(client)[:1]:
                os.kill(pid, signal.SIGKILL)

    return look, left


def test_a_worker_is_killed_while_it_renders(mortals, room):
    wait_for(mortals, 2)
    look, left = kill_at([0.2], mortals)
    found = rs.cluster.render(room, **ASKED, client=mortals, progress=look)
    assert not left
    assert_same_bits(found.pixels, rs.render(room, **ASKED).pixels)


@pytest.mark.exhaustive
def test_workers_are_killed_again_and_again_while_they_render(mortals, room):
    wait_for(mortals, 2)
    look, left = kill_at([0.1, 0.15, 0.5, 0.55, 0.8], mortals)
    found = rs.cluster.render(room, **ASKED, client=mortals, progress=look)
    assert not left
    assert_same_bits(found.pixels, rs.render(room, **ASKED).pixels)


@pytest.mark.exhaustive
def test_all_workers_are_killed_and_fetch_anew(mortals, room):
    import dask.array as da

    wait_for(mortals, 2)
    directions = np.random.default_rng(1).normal(size=(900, 3))
    with rs.cluster.Tracer(room, mortals) as tracer:
        hits = tracer.first_hit(room.camera.eye, da.from_array(directions, chunks=(90, 3)))
        first = hits.compute(scheduler=mortals)
        for pid in pids_of(mortals):
            os.kill(pid, signal.SIGKILL)
        again = hits.compute(scheduler=mortals)
    assert_same_bits(first.t, again.t)
    assert_same_bits(first.t, rs.Tracer(room).first_hit(room.camera.eye, directions).t)


def dying():
    """A function that dies as often as there are files in a folder, then answers.

    It is made here, so that it travels as a whole: workers cannot import this file.
    """

    def die_while_there_is(folder, number):
        for file in sorted(Path(folder).iterdir()):
            file.unlink()
            os.kill(os.getpid(), signal.SIGKILL)
        return number

    return die_while_there_is


@pytest.mark.exhaustive
def test_work_survives_more_kills_than_dask_allows(mortals, tmp_path):
    for k in range(6):  # Dask gives a task up after the fourth
        (tmp_path / str(k)).touch()
    tasks = OrderedTasks(mortals, dying(), [(str(tmp_path), n) for n in range(3)], 1, "die")
    assert list(tasks) == [0, 1, 2]
    assert not list(tmp_path.iterdir())


@pytest.mark.exhaustive
def test_work_that_always_kills_is_given_up(mortals, tmp_path, monkeypatch):
    monkeypatch.setattr(cluster_tasks, "MAX_ATTEMPTS", 1)
    for k in range(9):
        (tmp_path / str(k)).touch()
    tasks = OrderedTasks(mortals, dying(), [(str(tmp_path), 1)], 1, "die")
    with pytest.raises(ClusterError, match="kills worker after worker"):
        next(tasks)
    tasks.close()
    for file in tmp_path.iterdir():
        file.unlink()


@pytest.mark.exhaustive
def test_a_worker_that_joins_late_fetches_what_it_needs(cluster, client, room):
    import dask
    import dask.array as da

    wait_for(client, 2)
    directions = np.random.default_rng(1).normal(size=(100, 3))
    with rs.cluster.Tracer(room, client) as tracer:
        before = set(client.nthreads())
        cluster.scale(3)
        wait_for(client, 3)
        (late,) = set(client.nthreads()) - before
        with dask.annotate(workers=[late]):
            t = tracer.first_hit(room.camera.eye, da.from_array(directions)).t
        found = client.compute(t, workers=[late], optimize_graph=False).result()
        has_traced = lambda: "raystream.structures.bvh.structure" in sys.modules  # noqa: E731
        assert client.run(has_traced, workers=[late]) == {late: True}
    assert_same_bits(found, rs.Tracer(room).first_hit(room.camera.eye, directions).t)
    cluster.scale(2)
    while len(client.nthreads()) > 2:
        time.sleep(0.05)


def test_a_cluster_without_workers_says_so(room, monkeypatch):
    from distributed import Client, LocalCluster

    monkeypatch.setattr(clients, "TIMEOUT", 0.2)
    local = "127.0.0.1:0"
    with (
        LocalCluster(n_workers=0, processes=False, dashboard_address=local) as few,
        Client(few, set_as_default=False) as client,
        pytest.raises(ClusterError, match="has no workers"),
    ):
        rs.cluster.render(room, size=(4, 3), client=client)


def test_nobody_at_the_address(room, monkeypatch):
    monkeypatch.setattr(clients, "TIMEOUT", 0.6)
    with pytest.raises(ClusterError, match="no Dask scheduler answers"):
        rs.cluster.render(room, size=(4, 3), client="tcp://127.0.0.1:1")


def test_a_lost_cluster_leaves_the_samples(room, tmp_path):
    """In threads of this process: only the end of the connection matters."""
    from distributed import Client, LocalCluster

    checkpoint = tmp_path / "samples.npz"
    asked = {"mode": "raycast", "size": (16, 12), "samples": 400, "checkpoint": checkpoint}
    local = "127.0.0.1:0"
    with LocalCluster(n_workers=1, processes=False, dashboard_address=local) as cluster:
        client = Client(cluster, set_as_default=False)

        def leave(done, total):
            if done * 10 >= total:
                client.close()

        with pytest.raises(ClusterError, match="connection"):
            rs.cluster.render(room, **asked, client=client, progress=leave)
    found = rs.render(room, **asked)
    assert_same_bits(found.pixels, rs.render(room, **{**asked, "checkpoint": None}).pixels)
