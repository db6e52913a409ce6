"""``raystream query`` of rays in a Zarr store."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from extras import need

need("zarr")

import zarr

import raystream as rs
from ray_stores import assert_tracers, content_of, cornell_rays, read_store, write_store

ASKED = ("query", "cornell", "rays.zarr", "-o", "hits.zarr")
RECORD = Path("hits.zarr.progress.json")


@pytest.fixture
def rays(tmp_path):
    rays = cornell_rays((1000,))
    write_store(tmp_path / "rays.zarr", rays, (200,))
    return rays


def test_all_hits_are_the_librarys(run, rays):
    result = run(*ASKED, "--multi", "--max-hits", 2, "--crossings", "surfaces", "--json")
    assert result.err == ""
    options = {"max_hits": 2, "crossings": "surfaces"}
    tracer = rs.Tracer(rs.load("cornell"))
    found = read_store(Path("hits.zarr"))
    assert_tracers(found, tracer, "multi_hit", rays, options)
    figures = result.figures
    assert (figures["output"], figures["query"]) == ("hits.zarr", "multi")
    assert (figures["rays"], figures["rays_before"]) == (1000, 0)
    assert figures["hits"] == len(found["t"])
    assert figures["rays_hit"] == np.count_nonzero(np.diff(found["ray_splits"]))
    assert figures["invalid_rays"] == np.count_nonzero(found["status"])
    assert set(figures["seconds"]) - {"compile"} == {"load", "build", "trace", "read", "write"}


@pytest.mark.parametrize("kind", ["first", "any", "multi", "count"])
def test_files_of_both_kinds_have_the_same_arrays(run, rays, tmp_path, kind):
    np.savez(tmp_path / "rays.npz", **rays)
    run(*ASKED, f"--{kind}")
    run("query", "cornell", "rays.npz", "-o", "hits.npz", f"--{kind}")
    stored = read_store(Path("hits.zarr"))
    with np.load("hits.npz") as found:
        assert set(found) == set(stored)
        for name in found:
            np.testing.assert_array_equal(found[name], stored[name])
            assert found[name].dtype == stored[name].dtype


def test_figures_for_people(run, rays):
    out = run(*ASKED, "--any", "--block-rays", 300).out
    assert out.startswith("hits.zarr: 1,000 rays, ")
    assert out.endswith(" Mrays/s\n")


def begin_and_interrupt(run, monkeypatch, *more) -> str:
    """Ctrl-C once 400 rays are done."""
    from raystream.ray_files import block_query

    ask = block_query.BlockQuery.__call__

    def interrupted(self, block, *arguments):
        if block.begin == 400:
            raise KeyboardInterrupt
        return ask(self, block, *arguments)

    with monkeypatch.context() as patch:
        patch.setattr(block_query.BlockQuery, "__call__", interrupted)
        result = run(*ASKED, "--block-rays", 200, *more)
    assert (result.code, result.out) == (130, "")
    assert result.err.count("\n") == 1
    return result.err


def test_ctrl_c_tells_what_is_done(run, rays, monkeypatch):
    told = begin_and_interrupt(run, monkeypatch)
    assert told == (
        "interrupted; 400 rays are done, with their hits in hits.zarr; rerun with --resume "
        "to continue\n"
    )
    assert "--resume" in run(*ASKED, "--block-rays", 200).complaint
    result = run(*ASKED, "--block-rays", 200, "--resume", "--json")
    assert result.err == "hits.zarr: resumed at 400 of 1,000 rays\n"
    assert result.figures["rays_before"] == 400
    assert not RECORD.exists()
    before = content_of(Path("hits.zarr"))
    again = run(*ASKED, "--block-rays", 200, "--resume", "--json")
    assert (again.err, again.figures["rays_before"]) == ("", 1000)
    assert again.figures["rays_hit"] == result.figures["rays_hit"]
    assert content_of(Path("hits.zarr")) == before


def test_another_query_is_rejected_in_one_line(run, rays, monkeypatch):
    begin_and_interrupt(run, monkeypatch)
    complaint = run(*ASKED, "--block-rays", 200, "--resume", "--any").complaint
    assert complaint.startswith(f"{RECORD}: belongs to another query (")
    assert "query" in complaint


def test_full_disk_is_one_line(run, rays, monkeypatch):
    async def fill_up(self, key, *arguments, **named):
        if key.startswith("t/c/3"):
            raise OSError(28, "No space left on device")
        await put(self, key, *arguments, **named)

    put = zarr.storage.LocalStore.set
    with monkeypatch.context() as patch:
        patch.setattr(zarr.storage.LocalStore, "set", fill_up)
        complaint = run(*ASKED, "--block-rays", 200).complaint
    assert complaint == (
        "hits.zarr: No space left on device; finished blocks are saved; rerun with "
        "--resume to continue"
    )
    assert run(*ASKED, "--block-rays", 200, "--resume").err.startswith("hits.zarr: resumed at 600")


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["-o", "hits.npz"], "hits.npz: hits of rays in a Zarr store must be written to a .zarr"),
        (["-o", "nowhere/hits.zarr"], "nowhere"),
        (["-o", "file.zarr"], "file.zarr: is a file"),
        (["-o", "rays.zarr"], "rays.zarr: rays and hits must be separate"),
        (["--any", "--max-hits", "3"], "--max-hits"),
        (["--block-rays", "0"], "--block-rays"),
    ],
)
def test_bad_option_is_refused_in_one_line(run, rays, arguments, named):
    Path("file.zarr").write_text("mine")
    before = content_of(Path("rays.zarr"))
    assert named in run(*ASKED, *arguments).complaint
    assert content_of(Path("rays.zarr")) == before


@pytest.mark.parametrize("option", [["--resume"], ["--block-rays", "5"]])
def test_options_of_stores_are_refused_for_files(run, tmp_path, option):
    np.savez(tmp_path / "rays.npz", **cornell_rays((3,)))
    named = ("query", "cornell", "rays.npz", "-o", "hits.npz", *option)
    assert run(*named).complaint.startswith(f"{option[0]}: only with rays and hits in Zarr stores")


@pytest.mark.parametrize("rays", ["none.zarr", "text.zarr", "folder"])
def test_no_store_is_refused_in_one_line(run, tmp_path, rays):
    (tmp_path / "text.zarr").write_text("no store")
    (tmp_path / "folder").mkdir()
    complaint = run("query", "no such scene", rays, "-o", "hits.zarr").complaint
    assert complaint.startswith(f"{rays}: ")
    assert not (tmp_path / "hits.zarr").exists()


BLOCKS = 16

#: Parts of the way at which the process is killed, one after the other. All are for .ci/nightly.
KILLS = [(0.4,), (0.0, 0.5), (0.2, 0.3, 0.8)]


@pytest.mark.skipif(os.name == "nt", reason="needs POSIX signals")
@pytest.mark.parametrize(
    ("query", "kills"),
    [
        pytest.param(
            query,
            kills,
            marks=pytest.mark.slow
            if (query, kills) == ("multi", (0.4,))
            else pytest.mark.exhaustive,
        )
        for query in ("first", "any", "count", "multi")
        for kills in KILLS
    ],
)
def test_killed_process_goes_on_to_the_same_bytes(run, environment, tmp_path, query, kills):
    """Killed at an arbitrary point, not at a convenient one."""
    count = BLOCKS * 1000
    write_store(tmp_path / "rays.zarr", cornell_rays((count,)), (500,))
    asked = (*ASKED, f"--{query}", "--block-rays", "1000", "--structure", "brute")
    assert run(*asked[:3], "-o", "whole.zarr", *asked[5:]).code == 0
    command = [sys.executable, "-m", "raystream", *asked, "--resume"]
    for kill in kills:
        process = subprocess.Popen(command, cwd=tmp_path, env=environment, stderr=subprocess.PIPE)
        try:
            end = time.monotonic() + 100
            while rays_done() < kill * count:
                assert time.monotonic() < end
                assert process.poll() is None
                time.sleep(0.001)
            process.kill()
            process.communicate(timeout=60)
        finally:
            process.kill()
        assert process.returncode == -signal.SIGKILL
        assert kill * count <= rays_done() < count
    done = rays_done()
    figures = run(*asked, "--resume", "--json").figures
    assert figures["rays_before"] == done
    assert content_of(Path("hits.zarr")) == content_of(Path("whole.zarr"))
    assert not RECORD.exists()


def rays_done() -> int:
    try:
        return json.loads(RECORD.read_text())["done"]["rays"]
    except FileNotFoundError:
        return 0
