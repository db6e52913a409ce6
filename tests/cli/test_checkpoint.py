"""``raystream render --resume``: interrupted images are resumed."""

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
from extras import need
from raystream.rendering import progressive, sample_file
from raystream.rendering.film import Film
from raystream.rendering.image import Image

SAMPLES = 200
PICTURE = ("render", "cornell", "--mode", "path", "--size", "32x24", "--samples", SAMPLES)
KEPT = "out.exr.samples.npz"


@pytest.fixture
def exr():
    need("OpenEXR")


def break_off(number: int, environment: dict[str, str], folder: Path) -> tuple[int, str]:
    """Send a signal to a process that renders, once it has kept samples and shown an image."""
    command = [sys.executable, "-m", "raystream", *map(str, PICTURE), "-o", "out.exr"]
    process = subprocess.Popen(
        command,
        env={**environment, "RAYSTREAM_CHECKPOINT_SECONDS": "0"},
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        end = time.monotonic() + 100
        while not ((folder / KEPT).exists() and (folder / "out.exr").exists()):
            assert time.monotonic() < end
            assert process.poll() is None
            time.sleep(0.002)
        process.send_signal(number)
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert out == ""
    return process.returncode, err


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="needs POSIX signals")
@pytest.mark.parametrize("name", ["SIGKILL", "SIGINT"])
def test_picture_goes_on_to_the_same_bytes(run, exr, environment, tmp_path, name):
    code, err = break_off(getattr(signal, name), environment, tmp_path)
    if name == "SIGKILL":
        assert code == -signal.SIGKILL
    else:
        assert code == 130
        assert err.startswith(f"interrupted; {KEPT} contains the samples")
        assert "--resume" in err
        assert err.count("\n") == 1
    so_far = Image.load("out.exr").layers["samples"]
    assert 1 <= so_far.min() == so_far.max() < SAMPLES

    result = run(*PICTURE, "-o", "out.exr", "--resume", "--json")
    before = result.figures["samples_before"]
    assert so_far.max() <= before < SAMPLES
    assert result.err == f"out.exr: resumed from {before} samples\n"
    assert result.figures["samples_taken"] == SAMPLES
    assert result.figures["rays"] == 32 * 24 * (SAMPLES - before)
    assert not Path(KEPT).exists()

    assert run(*PICTURE, "-o", "whole.exr").code == 0
    assert Path("out.exr").read_bytes() == Path("whole.exr").read_bytes()


def interrupted(output: str, **options) -> None:
    """Leave three samples beside an image."""
    pixel_count = 32 * 24

    def stop(done, total):
        if done > 3 * pixel_count:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rs.render(
            rs.load("cornell"),
            **{"mode": "path", "size": (32, 24), "samples": 5, **options},
            checkpoint=f"{output}.samples.npz",
            progress=stop,
        )


ASKED = ("render", "cornell", "--mode", "path", "--size", "32x24", "--samples", 5, "-o", "out.png")


def test_without_samples_resume_begins(run):
    result = run(*ASKED, "--resume", "--json")
    assert (result.code, result.err) == (0, "")
    assert result.figures["samples_before"] == 0


def test_samples_are_not_overwritten(run, tmp_path, monkeypatch):
    monkeypatch.setattr(progressive, "SAMPLES_SECONDS", 0.0)  # one at a time
    interrupted("out.png")
    kept = Path("out.png.samples.npz").read_bytes()
    complaint = run(*ASKED).complaint
    assert complaint.startswith("out.png.samples.npz: ")
    assert "--resume" in complaint
    assert Path("out.png.samples.npz").read_bytes() == kept
    assert run(*ASKED, "-o", "other.png").code == 0
    assert run(*ASKED, "--resume").err == "out.png: resumed from 3 samples\n"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["other.png", "out.png"]
    assert Path("out.png").read_bytes() == Path("other.png").read_bytes()


@pytest.mark.parametrize(
    ("options", "differing"),
    [({"seed": 1}, "sampler"), ({"mode": "kajiya"}, "mode"), ({"max_bounces": 2}, "options")],
)
def test_samples_of_another_picture_are_refused(run, options, differing):
    interrupted("out.png", **options)
    complaint = run(*ASKED, "--resume").complaint
    assert complaint.startswith("out.png.samples.npz: is a checkpoint of another image")
    assert differing in complaint
    assert complaint.endswith("delete it to start over, or choose another --output")
    assert Path("out.png.samples.npz").exists()
    assert not Path("out.png").exists()


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 no archive"])
def test_damaged_samples_are_refused(run, content):
    Path("out.png.samples.npz").write_bytes(content)
    complaint = run(*ASKED, "--resume").complaint
    assert complaint.startswith("out.png.samples.npz: ")
    assert complaint.endswith("delete it to start over, or choose another --output")


def test_folder_in_place_of_the_samples(run):
    Path("out.png.samples.npz").mkdir()
    for more in ([], ["--resume"]):
        assert run(*ASKED, *more).complaint.startswith("out.png.samples.npz: ")


def test_quick_picture_leaves_the_disk_and_the_scene_alone(run, tmp_path, monkeypatch):
    """Nothing is written but the image, and the scene is not read to know it again."""

    def forbidden(*_, **__):
        pytest.fail("a checkpoint for a picture of less than ten seconds")

    monkeypatch.setattr(Film, "save", forbidden)
    monkeypatch.setattr(sample_file, "identity", forbidden)
    for more in ([], ["--resume"]):
        assert run(*ASKED, *more).code == 0
    assert [path.name for path in tmp_path.iterdir()] == ["out.png"]


def test_checkpoints_come_once_they_are_due(run, monkeypatch):
    written = []
    save = Film.save

    def count(sums, *arguments):
        written.append(int(sums.counts.min()))
        save(sums, *arguments)

    monkeypatch.setattr(Film, "save", count)
    monkeypatch.setenv("RAYSTREAM_CHECKPOINT_SECONDS", "0")
    assert run(*ASKED).code == 0
    assert written == [1, 2, 3, 4, 5]


@pytest.mark.parametrize("taken", [1, 3])
def test_early_interrupt_keeps_the_samples(run, tmp_path, monkeypatch, taken):
    """Before the first checkpoint is due, it is written all the same."""
    trace = progressive.trace_samples

    def stop(renderer, setting, samples, *more):
        if taken in samples:
            raise KeyboardInterrupt
        return trace(renderer, setting, samples, *more)

    with monkeypatch.context() as patch:
        patch.setattr(progressive, "SAMPLES_SECONDS", 0.0)  # one at a time
        patch.setattr(progressive, "trace_samples", stop)
        result = run(*ASKED)
    assert result.code == 130
    assert result.err.startswith("interrupted; out.png.samples.npz contains the samples")
    assert run(*ASKED, "--resume").err == f"out.png: resumed from {taken} samples\n"
    assert run(*ASKED, "-o", "whole.png").code == 0
    assert Path("out.png").read_bytes() == Path("whole.png").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.png", "whole.png"]


@pytest.mark.parametrize(
    ("error", "says"),
    [
        (OSError(28, "No space left on device"), "raystream: out.png: No space left on device\n"),
        (KeyboardInterrupt(), "interrupted; out.png.samples.npz contains the samples so far; "),
    ],
    ids=["full disk", "Ctrl-C"],
)
def test_picture_that_is_not_saved_keeps_its_samples(run, monkeypatch, error, says):
    def fail(*_, **__):
        raise error

    with monkeypatch.context() as patch:
        patch.setattr(Image, "save", fail)
        assert run(*ASKED).err.startswith(says)
    assert run(*ASKED, "--resume").err == "out.png: resumed from 5 samples\n"
    assert run(*ASKED, "-o", "whole.png").code == 0
    assert Path("out.png").read_bytes() == Path("whole.png").read_bytes()


def test_disk_without_room_for_samples_is_one_line(run, monkeypatch):
    def fill_up(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Film, "save", fill_up)
    monkeypatch.setenv("RAYSTREAM_CHECKPOINT_SECONDS", "0")
    assert run(*ASKED).complaint == "out.png.samples.npz: No space left on device"


def test_bad_interval_is_refused(run, monkeypatch):
    monkeypatch.setenv("RAYSTREAM_CHECKPOINT_SECONDS", "often")
    assert run(*ASKED).complaint.startswith("RAYSTREAM_CHECKPOINT_SECONDS: expected seconds")


def test_interrupt_before_the_first_sample_leaves_nothing(run, tmp_path, monkeypatch):
    def load(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("raystream.scene.load.load", load)
    result = run(*ASKED)
    assert (result.code, result.err) == (130, "interrupted\n")
    assert not list(tmp_path.iterdir())


def test_finished_picture_has_the_librarys_pixels(run):
    from PIL import Image as Picture

    assert run(*ASKED).code == 0
    image = rs.render(rs.load("cornell"), "path", (32, 24), 5)
    with Picture.open("out.png") as picture:
        np.testing.assert_array_equal(np.asarray(picture), image.to_bytes())
