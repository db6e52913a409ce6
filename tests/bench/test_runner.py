"""The runner, with raystream and contenders made for it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import raystream as rs
from bench.fake_contenders import KINDS
from raystream.bench import contender_process, contenders
from raystream.bench.contender_process import ContenderError, ContenderProcess
from raystream.bench.contenders import Entry, Peer
from raystream.bench.report import make_notes, make_tables
from raystream.bench.results import SceneResult, read_result, write_result
from raystream.bench.runner import Bench, OtherContendersError, Plan, geometry_of
from raystream.jit.threads import set_thread_count

pytestmark = pytest.mark.usefixtures("few_objects", "peers")

OWN = Entry("raystream", "raystream", {})


@pytest.fixture(scope="module")
def peers():
    """Contenders of `fake_contenders` as peers."""
    made = {kind.lower(): Peer(f"bench.fake_contenders:{kind}", (), "pay for it") for kind in KINDS}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(contenders, "PEERS", made)
        yield
    set_thread_count(None)


@pytest.fixture(scope="module")
def box():
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))]
    return rs.Scene.from_arrays(corners, faces)


def plan_of(*names, sets=("primary", "ao", "multi"), repeats=3):
    entries = [OWN, *(Entry(name, name, {}) for name in names)]
    return Plan(entries, sets, (8, 6), repeats=repeats)


@pytest.fixture(scope="module")
def result(peers, box):
    """A run in which all kinds of things go wrong."""
    with Bench(plan_of("nearsighted", "broken", "crashing", "killed", "missing")) as bench:
        bench.open()
        bench.run("box", box)
    return bench.result


def test_everybody_takes_part_in_every_round(result):
    (scene,) = result.scenes
    assert scene.is_complete
    assert scene.wall_seconds > 0.0
    assert scene.triangle_count == 12
    primary, _, multi = scene.sets
    assert {mode: len(times) for mode, times in primary.seconds["nearsighted"].items()} == {
        "near": 3,
        "far": 3,
    }
    assert set(primary.warm_up["nearsighted"]) == {"near", "far"}
    assert len(primary.seconds["raystream"][""]) == 3
    assert primary.ray_count == 48
    assert primary.hit_count > 0
    # The worse of its modes counts for agreement.
    assert primary.agreement["nearsighted"] == (primary.hit_count / 48, 0)
    assert multi.failures["nearsighted"] == "does not support this query"
    assert multi.hit_count == 2 * primary.hit_count  # in and out of the box
    assert primary.best_peer(["nearsighted"]) == "nearsighted"
    assert primary.ratio("raystream", "nearsighted") > 0
    assert scene.builds["raystream"].start_seconds > 0.0


def test_absent_and_failing_contenders_are_reported(result):
    (scene,) = result.scenes
    assert result.absent == {"missing": "not today (pay for it)"}
    assert result.labels == ["raystream", "nearsighted", "broken", "crashing", "killed"]
    assert scene.failures["broken"] == "RuntimeError: no boxes"
    notes = "\n".join(make_notes(result))
    assert "missing is absent: not today (pay for it)" in notes
    assert "box: broken: RuntimeError: no boxes" in notes


def test_crashes_lose_no_other_results(result):
    (scene,) = result.scenes
    killed = "its process was ended by SIGKILL (out of memory?)"
    assert scene.failures["killed"].startswith(killed)
    crash = "its process ended with status 3: for me"
    primary, ao, multi = scene.sets
    assert scene.failures["crashing"] == ao.failures["crashing"] == multi.failures["crashing"]
    assert ao.failures["crashing"] == crash
    assert len(primary.seconds["crashing"][""]) == 3  # before it crashed
    assert "crashing" not in ao.seconds
    assert all(len(rays.seconds["raystream"][""]) == 3 for rays in scene.sets)


def test_half_an_answer_is_a_failure(box):
    with Bench(plan_of("interrupted", sets=("primary",), repeats=1)) as bench:
        bench.open()
        bench.run("box", box)
    (scene,) = bench.result.scenes
    assert scene.failures["interrupted"].startswith("its process was ended by SIGKILL")
    assert scene.is_complete


def test_a_contender_that_does_not_answer_is_ended(box, monkeypatch):
    monkeypatch.setattr(contender_process, "MAX_SECONDS", 60.0)
    with Bench(plan_of("silent", sets=("primary",), repeats=1)) as bench:
        bench.open()
        monkeypatch.setattr(contender_process, "MAX_SECONDS", 1.0)
        bench.run("box", box)
    (scene,) = bench.result.scenes
    assert scene.failures["silent"].startswith("no answer for 1 s")
    assert scene.is_complete


def test_a_crash_of_our_own_is_not_a_result(box):
    with Bench(Plan([OWN], ["primary"], (8, 6), repeats=1)) as bench:
        bench.open()
        process = bench._processes["raystream"]
        process._process.kill()
        with pytest.raises(ContenderError, match="SIGKILL"):
            bench.run("box", box)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc, as on Linux")
def test_processes_stand_still_between_requests():
    process = ContenderProcess(Entry("nearsighted", "nearsighted", {}), 1)
    try:
        assert process.about["notes"] == "does not see far"
        stat = Path(f"/proc/{process._process.pid}/stat")
        deadline = time.monotonic() + 10.0
        while stat.read_text().rpartition(")")[2].split()[0] != "T":
            assert time.monotonic() < deadline
        assert os.getpgid(process._process.pid) != os.getpgid(0)  # Ctrl-C does not reach it
        with pytest.raises(ContenderError, match="KeyError: 'no such request'"):
            process.ask("no such request")
        assert process.is_alive
    finally:
        process.close()
    assert not process.is_alive


def test_an_interrupt_keeps_what_there_is_and_the_run_goes_on(box, tmp_path):
    path = tmp_path / "result.json"
    plan = Plan([OWN], ["primary", "ao"], (8, 6), repeats=2)

    def keep(result):
        write_result(path, result)
        if result.scenes[-1].scene == "b" and not stopped:
            stopped.append(len(result.scenes[-1].sets))
            raise KeyboardInterrupt

    stopped = []
    with Bench(plan, keep) as bench:
        bench.open()
        bench.run("a", box)
        with pytest.raises(KeyboardInterrupt):
            bench.run("b", box)
    earlier = read_result(path)
    assert [(one.scene, one.is_complete) for one in earlier.scenes] == [("a", True), ("b", False)]
    assert [len(one.sets) for one in earlier.scenes] == [2, 1]
    assert any("b is incomplete" in note for note in make_notes(earlier))

    first = earlier.scenes[0].sets[0].seconds
    with Bench(plan, keep, earlier) as bench:
        bench.open()
        assert bench.has("a")
        assert not bench.has("b")
        bench.run("b", box)
    again = read_result(path)
    assert [(one.scene, one.is_complete) for one in again.scenes] == [("a", True), ("b", True)]
    assert again.scenes[0].sets[0].seconds == first
    other = Plan([OWN], ["primary"], (8, 6), repeats=2)
    with pytest.raises(ValueError, match="different settings"):
        Bench(other, keep, again)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"raystream": "0.0.1", "nearsighted": rs.__version__}, "raystream 0.0.1 (now "),
        ({"raystream": rs.__version__}, "nearsighted none (now "),
        (
            {"raystream": rs.__version__, "nearsighted": rs.__version__, "missing": "3"},
            "missing 3 (now none)",
        ),
    ],
)
def test_other_contenders_are_not_mixed_into_a_result(change, words):
    plan = plan_of("nearsighted", "missing")
    with Bench(plan) as bench:
        earlier = bench.result
    earlier.versions = dict(change)
    earlier.scenes.append(SceneResult("a", 12, is_complete=True))
    with Bench(plan, earlier=earlier) as bench, pytest.raises(OtherContendersError) as caught:
        bench.open()
    assert words in str(caught.value)
    assert earlier.versions == change  # the earlier result stays as it was


def test_a_resumed_result_forgets_old_notes_and_skipped_scenes(box):
    plan = Plan([OWN], ["primary"], (8, 6), repeats=1)
    with Bench(plan) as bench:
        earlier = bench.result
    earlier.notes, earlier.skipped = {"raystream": "old"}, {"box": "no file", "other": "no file"}
    with Bench(plan, earlier=earlier) as bench:
        bench.open()
        bench.run("box", box)
    assert "old" not in bench.result.notes.values()
    assert bench.result.skipped == {"other": "no file"}


LONELY = """
import os, signal
from raystream.bench.contender_process import ContenderProcess
from raystream.bench.contenders import Entry
process = ContenderProcess(Entry("raystream", "raystream", {}), 1)
print(process._process.pid, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs prctl, as on Linux")
def test_a_killed_bench_leaves_no_process():
    """Its worker is stopped, in the session of the process that adopts it."""
    done = subprocess.run([sys.executable, "-c", LONELY], stdout=subprocess.PIPE, check=False)
    assert done.returncode == -signal.SIGKILL
    stat = Path(f"/proc/{int(done.stdout)}/stat")
    deadline = time.monotonic() + 20.0
    # Nobody may collect the exit status of what is ended.
    while stat.exists() and stat.read_text().rpartition(")")[2].split()[0] not in "ZX":
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_variants_are_contenders(box):
    entries = [OWN, Entry("b", "raystream", {"max_leaf_size": 1})]
    with Bench(Plan(entries, ["primary"], (8, 6), repeats=1)) as bench:
        bench.open()
        bench.run("box", box)
    (scene,) = bench.result.scenes
    assert bench.result.own == ["raystream", "b"]
    assert scene.sets[0].agreement["b"].differing == 0.0


@pytest.mark.parametrize(
    ("options", "is_counted"),
    [({"kernel": "single"}, True), ({"max_leaf_size": 8}, False), ({"structure": "grid"}, False)],
)
def test_tests_are_counted_where_a_leaf_is_a_block(box, tmp_path, options, is_counted):
    bench = Bench(Plan([Entry("raystream", "raystream", options)], ["primary"], (8, 6)))
    (stored,) = bench._make_sets(box, tmp_path)
    assert (stored.measured.counts is not None) == is_counted


def test_wrong_options_are_refused():
    entries = [Entry("raystream", "raystream", {"speed": "high"})]
    with pytest.raises(TypeError, match="speed"):
        Bench(Plan(entries)).open()
    with pytest.raises(ValueError, match="raystream first"):
        Bench(Plan([Entry("warp", "warp", {})]))


def test_the_estimate_grows_with_the_work():
    seconds = Plan([OWN], threads=2).expected_seconds(10)
    assert Plan([OWN], threads=4).expected_seconds(10) < seconds
    assert Plan([OWN], threads=2, size=(2048, 768)).expected_seconds(10) > seconds
    entries = [OWN, *(Entry(str(k), "raystream", {}) for k in range(5))]
    assert 300.0 < Plan(entries, threads=2).expected_seconds(10) < 2700.0


def test_tables_of_a_run(result):
    speeds, builds, roofline, goals = make_tables(result)
    assert speeds.columns[:4] == ["rays", "count", "raystream", "nearsighted"]
    assert [row[0] for row in speeds.rows] == ["primary", "ao", "multi"]
    for table in (speeds, builds, roofline, goals):
        assert all(len(row) == len(table.columns) for row in table.rows)
    assert "! nearsighted" in speeds.rows[0][-1]
    assert speeds.rows[2][3] == "–"
    assert builds.rows[0][1] == "build, s"
    assert [row[0] for row in goals.rows] == ["primary, (N, 3)", "ambient occlusion"]
    assert any("does not see far" in note for note in make_notes(result))


def test_meshes_are_put_together_in_order():
    one = rs.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    two = rs.Mesh([[0, 0, 5], [1, 0, 5], [0, 1, 5], [9, 9, 9]], [[0, 1, 2], [2, 1, 3]])
    geometry = geometry_of(rs.Scene([one, two]))
    assert geometry.vertices.shape == (7, 3)
    assert geometry.faces.tolist() == [[0, 1, 2], [3, 4, 5], [5, 4, 6]]
    assert (geometry.vertices.dtype, geometry.faces.dtype) == (np.float32, np.int32)
    with pytest.raises(ValueError, match="no triangles"):
        geometry_of(rs.Scene([]))
