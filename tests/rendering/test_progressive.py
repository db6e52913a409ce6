"""Rendering sample by sample: progress, checkpoints, and interrupts."""

from __future__ import annotations

import signal
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

import raystream as rs
from raystream.core.query import Kind
from raystream.jit.threads import set_thread_count
from raystream.rendering import progressive, sample_bands, sample_file
from raystream.rendering.film import Film
from raystream.rendering.limits import FIRST_SAMPLES, Limits, Pace
from raystream.structures.bvh import batches as tables

PIXELS = 16 * 12
PICTURE = {"mode": "path", "size": (16, 12)}


@pytest.fixture(scope="module")
def tracer():
    return rs.Tracer(rs.load("cornell"))


def test_progress_begins_with_what_is_there_and_ends_with_what_was_taken(tracer, tmp_path):
    kept = tmp_path / "a.npz"
    for samples, before in ((3, 0), (7, 3)):
        seen = []
        rs.render(
            tracer,
            **PICTURE,
            samples=samples,
            checkpoint=kept,
            progress=lambda *report: seen.append(report),  # noqa: B023
        )
        assert seen[0] == (before * PIXELS, samples * PIXELS)
        assert seen[-1] == (samples * PIXELS, samples * PIXELS)
        assert seen == sorted(seen)


MOST = 100_000


def limited(tracer, **limit):
    """Samples taken until a limit, and the reports of progress."""
    seen = []
    report = lambda *numbers: seen.append(numbers)  # noqa: E731
    image = rs.render(tracer, **PICTURE, samples=MOST, **limit, progress=report)
    taken = image.figures["samples"]
    assert (image.layers["samples"] == taken).all()
    assert seen[-1] == (taken * PIXELS, taken * PIXELS)
    return taken, seen


def test_progress_foretells_the_samples_for_a_noise(tracer):
    """From the middle on, the number is right within a factor of two."""
    taken, seen = limited(tracer, noise=0.7)
    assert 16 <= taken < MOST
    later = [total / PIXELS for done, total in seen if done > taken * PIXELS / 2]
    assert all(taken / 2 < total < taken * 2 for total in later)


def test_progress_counts_towards_a_time(tracer):
    """Any number of samples may fit: of the second one on, it is not all that were allowed."""
    rs.render(tracer, **PICTURE, samples=2)  # compiles
    taken, seen = limited(tracer, time_limit=0.2)
    assert taken < MOST
    assert all(total < MOST * PIXELS for done, total in seen if done > PIXELS)


def test_time_ends_an_image_at_the_nearest_sample():
    film = Film(2, 2)
    film.add_samples(0, np.ones((4, 3), np.float32))
    limits = Limits(100, seconds=5.0)
    assert limits.expected_paths(film, Pace(4, 1.0, np.inf)) == 400  # nothing is known yet
    assert limits.expected_paths(film, Pace(0, 1.0, np.inf)) == 4 + 16  # four samples of a second
    assert limits.expected_paths(film, Pace(0, 3.0, 0.25)) == 4 + 8  # the start took two
    assert limits.expected_paths(film, Pace(0, 4.4, 0.25)) == 8
    assert limits.expected_paths(film, Pace(0, 4.6, 0.25)) == 4  # the next would end at 5.6
    assert limits.expected_paths(film, Pace(0, 4.6, np.inf)) == 8
    assert limits.expected_paths(film, Pace(0, 5.0, 1e-9)) == 4
    assert limits.expected_paths(film, None) == 400
    assert Limits(100, seconds=1e-3).expected_paths(Film(2, 2), Pace(0, 9.0, np.inf)) == 400


@pytest.mark.parametrize(
    ("limit", "taken"),
    [
        (0.5, 1),  # the first takes a second
        (3.4, 3),
        (3.6, 4),
        (20.0, 20),
    ],
)
@pytest.mark.parametrize("hitch", [0.0, 50.0])
def test_time_drops_nothing_that_is_traced(tracer, monkeypatch, limit, taken, hitch):
    """By a clock that only samples advance, one second each, and by a hitch after the first."""
    now, trace_samples = [0.0], progressive.trace_samples
    traced = []

    def trace(renderer, context, samples, progress):
        traced.extend(samples)
        now[0] += len(samples) + (hitch if 1 in samples else 0.0)
        return trace_samples(renderer, context, samples, progress)

    monkeypatch.setattr(progressive, "time", SimpleNamespace(monotonic=lambda: now[0]))
    monkeypatch.setattr(progressive, "trace_samples", trace)
    monkeypatch.setattr(progressive, "SAMPLES_SECONDS", 4.0)
    image = rs.render(tracer, **PICTURE, time_limit=limit)
    assert image.figures["samples"] == len(traced)
    assert traced == [*range(len(traced))]
    if not hitch or taken == 1:
        assert len(traced) == taken
    else:
        assert 1 < len(traced) <= 5


def test_limits_without_samples_take_more_than_the_default(tracer):
    whole = rs.render(tracer, **PICTURE, samples=40)
    image = rs.render(tracer, **PICTURE, noise=whole.figures["error"])
    assert image.figures["samples"] > 30
    with pytest.raises(ValueError, match=r"^samples: .*stratified"):
        rs.render(tracer, **PICTURE, noise=0.5, sampler="stratified")
    track = rs.CameraTrack(tracer.scene.camera, [[0, 278, 273, -800], [1, 278, 273, -700]])
    asked = {"frames": [0], "camera": track, "noise": whole.figures["error"]}
    ((_, frame),) = rs.render_frames(tracer.scene, **PICTURE, **asked)
    assert frame.figures["samples"] > 30


def test_interrupt_waits_for_a_sample_that_is_being_added(tracer, tmp_path, monkeypatch):
    """Sums with half of a sample would make another image."""
    add_samples = Film.add_samples

    def interrupt_and_add(*arguments):
        signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
        time.sleep(0.05)
        add_samples(*arguments)

    if not hasattr(signal, "pthread_kill"):
        pytest.skip("needs POSIX signals")
    kept = tmp_path / "a.npz"
    with monkeypatch.context() as patch:
        patch.setattr(Film, "add_samples", interrupt_and_add)
        with pytest.raises(KeyboardInterrupt):
            rs.render(tracer, **PICTURE, samples=4, checkpoint=kept)
    with np.load(kept) as file:
        assert (file["counts"] == 1).all()
    image = rs.render(tracer, **PICTURE, samples=4, checkpoint=kept)
    whole = rs.render(tracer, **PICTURE, samples=4)
    np.testing.assert_array_equal(image.pixels, whole.pixels)
    np.testing.assert_array_equal(image.layers["variance"], whole.layers["variance"])


@pytest.fixture
def at_once(monkeypatch):
    """Numbers of samples that are traced at once, however long they take."""
    seen = []
    trace_samples = progressive.trace_samples

    def note(renderer, context, samples, progress):
        seen.append(len(samples))
        return trace_samples(renderer, context, samples, progress)

    monkeypatch.setattr(progressive, "SAMPLES_SECONDS", 1e9)
    monkeypatch.setenv("RAYSTREAM_CHECKPOINT_SECONDS", "1e9")
    monkeypatch.setattr(progressive, "trace_samples", note)
    return seen


@pytest.mark.parametrize("count", [1, 2, 3])
def test_samples_at_once_give_the_bits_of_one_by_one(tracer, at_once, monkeypatch, count):
    many = {"mode": "path", "size": (50, 40), "samples": 6}
    monkeypatch.setattr(progressive, "SAMPLES_BYTES", 1)
    monkeypatch.setattr(sample_bands, "LEAST_BAND", 256)
    set_thread_count(count)
    try:
        singly = rs.render(tracer, **many)
        monkeypatch.setattr(progressive, "SAMPLES_BYTES", 1 << 20)
        together = rs.render(tracer, **many)
    finally:
        set_thread_count(None)
    assert at_once == [1] * 6 + [1, 5]
    np.testing.assert_array_equal(together.pixels, singly.pixels)
    np.testing.assert_array_equal(together.layers["variance"], singly.layers["variance"])


def test_a_clock_that_stands_still_sets_no_bound():
    """Coarse clocks do not advance during a small sample."""
    assert progressive._passes_at_once(7, PIXELS, 0.0, 10.0) == 7
    assert progressive._passes_at_once(7, PIXELS, 0.0, 0.0) == 1
    assert progressive._passes_at_once(7, PIXELS, np.inf, 10.0) == 1


@pytest.mark.ci
def test_checkpoints_do_not_count_as_time_of_samples(tracer, tmp_path, monkeypatch):
    seen, ask = [], progressive._passes_at_once

    def note(left, size, seconds, interval):
        seen.append(seconds)
        return ask(left, size, seconds, interval)

    monkeypatch.setenv("RAYSTREAM_CHECKPOINT_SECONDS", "0")
    monkeypatch.setattr(progressive, "_passes_at_once", note)
    rs.render(tracer, **PICTURE, samples=2)  # compiles
    seen.clear()
    rs.render(tracer, **PICTURE, samples=4, on_pass=lambda _: time.sleep(1.5))
    assert len(seen) == 4
    assert max(seen[1:]) < 1.5


def test_interrupt_keeps_whole_samples_only(tracer, at_once, tmp_path):
    kept = tmp_path / "a.npz"

    def stop(done, total):
        if done > PIXELS:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rs.render(tracer, **PICTURE, samples=9, checkpoint=kept, progress=stop)
    assert at_once == [1, 8]
    with np.load(kept) as file:
        assert len(set(file["counts"].tolist())) == 1
    image = rs.render(tracer, **PICTURE, samples=9, checkpoint=kept)
    whole = rs.render(tracer, **PICTURE, samples=9)
    np.testing.assert_array_equal(image.pixels, whole.pixels)


@pytest.mark.parametrize("limit", [{"noise": 0.0}, {"time_limit": 1e9}, {"layers": "all"}])
def test_samples_traced_at_once_end_where_single_ones_do(tracer, at_once, monkeypatch, limit):
    asked = {**PICTURE, "mode": "path", "samples": 60, **limit}
    if "noise" in limit:
        asked["noise"] = 1.5 * rs.render(tracer, **{**asked, "noise": None}).figures["error"]
        at_once.clear()
    together = rs.render(tracer, **asked)
    assert at_once[0] == 1
    assert at_once[1] > 1
    at_once.clear()
    monkeypatch.setattr(progressive, "SAMPLES_SECONDS", 0.0)
    singly = rs.render(tracer, **asked)
    assert set(at_once) == {1}
    if "noise" in limit:
        assert FIRST_SAMPLES <= singly.figures["samples"] < 60
    assert together.figures == singly.figures
    np.testing.assert_array_equal(together.pixels, singly.pixels)
    for name, layer in singly.layers.items():
        np.testing.assert_array_equal(together.layers[name], layer)


def test_interrupt_before_the_first_sample_leaves_no_checkpoint(tracer, tmp_path):
    def stop(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rs.render(tracer, **PICTURE, samples=4, checkpoint=tmp_path / "a.npz", progress=stop)
    assert not list(tmp_path.iterdir())


def test_passes_come_as_often_as_asked_for(tracer, monkeypatch):
    for seconds, count in (("0", 4), ("1e9", 0), ("", 0)):
        monkeypatch.setenv("RAYSTREAM_CHECKPOINT_SECONDS", seconds)
        passes = []
        rs.render(tracer, **PICTURE, samples=5, on_pass=passes.append)
        assert [int(image.layers["samples"].max()) for image in passes] == [*range(1, count + 1)]


@pytest.mark.parametrize("seconds", ["often", "-1", "nan", "inf"])
def test_bad_interval_is_refused(tracer, monkeypatch, seconds):
    monkeypatch.setenv("RAYSTREAM_CHECKPOINT_SECONDS", seconds)
    with pytest.raises(ValueError, match=r"^RAYSTREAM_CHECKPOINT_SECONDS: "):
        rs.render(tracer, **PICTURE)


def test_scene_is_read_for_a_checkpoint_only(tracer, tmp_path, monkeypatch):
    asked = []
    identity = sample_file.identity
    monkeypatch.setattr(
        sample_file, "identity", lambda *picture: asked.append(picture) or identity(*picture)
    )
    rs.render(tracer, **PICTURE, samples=3)
    assert len(asked) == 0
    for runs in (1, 2):  # written, then read and written
        rs.render(tracer, **PICTURE, samples=3, checkpoint=tmp_path / "a.npz")
        assert len(asked) == runs


@pytest.fixture
def batches(monkeypatch):
    """The rays that each call of the kernel for small batches gets."""
    seen = []
    kernels = tables.BATCH_KERNELS[Kind.FIRST_HIT].kernels
    kernel = kernels["wavefront"]

    def bind(structure, batch):
        trace, given = kernel.bind(structure, batch)

        def note(begin, end, *arguments):
            seen.append(end - begin)
            trace(begin, end, *arguments)

        return note, given

    monkeypatch.setitem(kernels, "wavefront", kernel._replace(bind=bind))
    yield seen
    set_thread_count(None)


@pytest.mark.parametrize("threads", [1, 2, 14])
@pytest.mark.parametrize("size", [(1024, 65), (1024, 96), (1023, 48), (1025, 48), (512, 9)])
def test_picture_of_large_batches_asks_for_no_kernel_for_small_ones(batches, size, threads):
    """It would be compiled for one row of a thousand pixels, the first or the last of them."""
    set_thread_count(threads)
    rs.render(rs.Tracer(rs.load("spheres")), "vis", size)
    assert batches == []


def test_small_picture_asks_for_it(batches):
    rs.render(rs.Tracer(rs.load("spheres")), "vis", (32, 24))
    assert sum(batches) >= 32 * 24
