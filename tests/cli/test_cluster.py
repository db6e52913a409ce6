"""``raystream render --cluster``."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from extras import need

need("distributed")

SIZE = ("--size", "24x18")


@pytest.fixture
def address():
    """A cluster in threads of this process: quick to start."""
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=1,
        processes=False,
        protocol="tcp://",
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
    ) as cluster:
        yield cluster.scheduler_address


def test_a_picture_and_an_animation_are_those_of_one_machine(run, address, tmp_path):
    asked = ("render", "cornell", *SIZE, "--mode", "whitted", "--samples", "2")
    alone = run(*asked, "-o", "alone.exr", "--json").figures
    result = run(*asked, "-o", "there.exr", "--json", "--cluster", address)
    assert result.code == 0, result.err
    there = result.figures
    assert (tmp_path / "alone.exr").read_bytes() == (tmp_path / "there.exr").read_bytes()
    differing = ("output", "seconds", "mrays_per_second")
    assert {k: v for k, v in alone.items() if k not in differing} == {
        k: v for k, v in there.items() if k not in differing
    }
    assert not list(tmp_path.glob("*.npz"))
    (tmp_path / "a.aff").write_text(
        "v from 0 0 5 at 0 0 0 up 0 1 0 angle 40\na 0 2 10\n"
        "x a { p 3 0 0 0 1 0 0 0 1 0 }\nk a { transl 2 0 -1 0 0 0 0 0 2 1 0 0 0 0 0 }\n"
    )
    animation = ("render", "a.aff", "--frames", "0:3", *SIZE)
    assert run(*animation, "-o", "alone%d.png").code == 0
    assert run(*animation, "-o", "there%d.png", "--cluster", address).code == 0
    for number in range(3):
        one, two = (tmp_path / f"{name}{number}.png" for name in ("alone", "there"))
        assert one.read_bytes() == two.read_bytes()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--cluster", "here"), "--cluster: client: expected an address"),
        (("--cluster", "local:0"), "expected local:1"),
        (("--cluster", "tcp://127.0.0.1:1", "--threads", "2"), "--threads"),
        (("--cluster", "local:2", "--heatmap", "steps"), "cluster"),
    ],
)
def test_what_is_no_cluster_is_refused(run, arguments, says):
    assert says in run("render", "cornell", *SIZE, *arguments).complaint


def test_without_dask_the_extra_is_named(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "dask", None)
    monkeypatch.setitem(sys.modules, "distributed", None)
    for name in [n for n in sys.modules if n.startswith("raystream.cluster")]:
        monkeypatch.delitem(sys.modules, name)
    complaint = run("render", "cornell", *SIZE, "--cluster", "local:2").complaint
    assert 'pip install "raystream[cluster]"' in complaint


@pytest.mark.exhaustive
@pytest.mark.skipif(not hasattr(os, "killpg"), reason="needs process groups")
def test_ctrl_c_keeps_the_samples_and_resume_goes_on(environment, tmp_path):
    """With its own workers, which get the signal, too."""
    asked = ["render", "cornell", "--size", "64x48", "--mode", "ao", "--samples", "5000"]
    command = [sys.executable, "-m", "raystream", *asked, "-o", "x.png"]
    on_cluster = [*command, "--cluster", "local:2"]
    quickly = {**environment, "RAYSTREAM_CHECKPOINT_SECONDS": "0"}
    process = subprocess.Popen(
        on_cluster,
        cwd=tmp_path,
        env=quickly,
        stderr=subprocess.PIPE,
        start_new_session=True,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    samples = Path(tmp_path) / "x.png.samples.npz"
    end = time.monotonic() + 120
    while not samples.exists() and time.monotonic() < end:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "rerun with --resume to continue" in said
    assert "Traceback" not in said
    assert samples.exists()
    shorter = ["200" if word == "5000" else word for word in on_cluster]
    again = subprocess.run(
        [*shorter, "--resume"], cwd=tmp_path, env=environment, capture_output=True, text=True
    )
    assert again.returncode == 0, again.stderr
    assert re.search("resumed from [0-9]+ samples", again.stderr)
