"""Frames of scenes that move, and videos of them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image as Pillow

import raystream as rs
from extras import need
from meshes import icosphere
from raystream.cli import frame_files
from raystream.core.errors import RaystreamError
from raystream.rendering.frames import frame_seed
from raystream.rendering.video import VIDEO_SUFFIXES, write_video
from scene.test_animation import TRIANGLE, moving_scene

CAMERA = rs.Camera((0.5, 1, 6), (0.5, 1, 0))
TRACK = rs.CameraTrack(CAMERA, [[0, 0.5, 1, 6], [2, 0.5, 1, 60]])
SIZE = (16, 12)


def test_frames_are_pictures_of_their_times() -> None:
    """To the bit, with tracers of their own; on a structure that was moved."""
    scene = moving_scene(camera=CAMERA)
    seen = []
    frames = rs.render_frames(scene, frames=slice(0, 8, 3), size=SIZE, samples=4, seed=5)
    for frame, image in frames:
        own = rs.render(scene.at(frame / 4), size=SIZE, samples=4, seed=frame_seed(5, frame))
        np.testing.assert_array_equal(image.pixels, own.pixels)
        seen.append(frame)
    assert seen == [0, 3, 6]
    assert frame_seed(5, 0) != frame_seed(5, 3) != frame_seed(4, 3)


@pytest.mark.parametrize("speed", [3e4, 5e6])
def test_frames_of_a_scene_that_moves_far_are_those_of_new_tracers(speed) -> None:
    ball = rs.Mesh(*icosphere(3))

    def at(time):
        place = np.array([speed * time, 0.0, 0.0])
        return rs.Scene([ball.moved(ball.vertices + place)])

    scene = rs.Scene([ball], animation=rs.Animation(at, (0, 2), fps=1))
    eye = np.array([speed, 0.0, 0.0])
    view = rs.Camera(tuple(eye + [0.3, 0.2, 4.0]), tuple(eye))
    options = {"camera": view, "size": SIZE, "samples": 4}
    for mode in ("raycast", "vis"):
        (_, image), *_ = reversed([*rs.render_frames(scene, mode, frames=[0, 1], **options)])
        own = rs.render(scene.at(1.0), mode, seed=frame_seed(0, 1), **options)
        np.testing.assert_array_equal(image.pixels, own.pixels)
        assert np.ptp(own.pixels) > 0


def test_meshes_may_come_and_go() -> None:
    def at(time):
        return rs.Scene([TRIANGLE][: int(time)])

    scene = rs.Scene(camera=CAMERA, animation=rs.Animation(at, (0, 2), fps=1))
    bright = [image.pixels.any() for _, image in rs.render_frames(scene, "vis", size=SIZE)]
    assert bright == [False, True]


def test_cameras_of_ones_own_move() -> None:
    scene = rs.Scene([TRIANGLE])
    reports = []
    options = {"camera": TRACK, "fps": 1, "size": SIZE}
    frames = rs.render_frames(scene, "vis", progress=lambda *r: reports.append(r), **options)
    near, far = [np.count_nonzero(image.pixels) for _, image in frames]
    assert near > 4 * far
    assert reports[-1] == (2 * 16 * 12,) * 2
    assert [done for done, _ in reports] == sorted(done for done, _ in reports)


@pytest.mark.parametrize(
    ("options", "kind", "reason"),
    [
        ({"camera": CAMERA}, ValueError, "is static"),
        ({"mode": "oil"}, ValueError, "mode: expected"),
        ({"checkpoint": "a"}, TypeError, "checkpoint: only for a single image"),
        ({"frames": 48, "camera": TRACK}, ValueError, "got 48"),
    ],
)
def test_bad_arguments_are_refused_at_once(options, kind, reason) -> None:
    with pytest.raises(kind, match=reason):
        rs.render_frames(rs.Scene([TRIANGLE]), **options)


def gradients(count: int, size: tuple[int, int] = SIZE) -> list[np.ndarray]:
    ramp = np.arange(size[1] * size[0] * 3, dtype=np.int64).reshape(size[1], size[0], 3)
    return [((ramp + 40 * i) % 256).astype(np.uint8) for i in range(count)]


@pytest.mark.parametrize("suffix", [".gif", ".webp", ".apng"])
def test_videos_have_all_frames(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"film{suffix}"
    pictures = gradients(5)
    write_video(path, iter(pictures), fps=12.5)
    with Pillow.open(path) as film:
        assert (film.n_frames, film.size) == (5, SIZE)
        durations = []
        for i in range(5):
            film.seek(i)
            film.load()
            durations.append(film.info["duration"])
            error = np.abs(np.asarray(film.convert("RGB"), int) - pictures[i]).mean()
            assert error < (0.5 if suffix == ".apng" else 40)
    assert durations == [80.0] * 5


def test_pictures_of_several_sizes_are_refused(tmp_path: Path) -> None:
    for pictures, reason in (
        ([], "at least one"),
        (gradients(1) + gradients(1, (8, 8)), "expected equal sizes"),
        ([np.zeros((4, 4), np.uint8)], "shape"),
    ):
        with pytest.raises(ValueError, match=reason):
            write_video(tmp_path / "a.gif", pictures)
    with pytest.raises(ValueError, match="must end in"):
        write_video(tmp_path / "a.avi", gradients(1))
    with pytest.raises(ValueError, match="fps"):
        write_video(tmp_path / "a.gif", gradients(1), fps=0)
    assert not list(tmp_path.iterdir())


def program(folder: Path, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A program named ffmpeg, in place of imageio-ffmpeg's."""
    path = folder / "ffmpeg"
    path.write_text(f"#!{sys.executable}\nimport sys\n{text}\n")
    path.chmod(0o755)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(path))


@pytest.mark.skipif(sys.platform == "win32", reason="needs programs that are scripts")
def test_ffmpeg_gets_all_pixels_and_its_failure_is_one_line(tmp_path, monkeypatch) -> None:
    """With stand-ins: one that records its input, one that fails at once."""
    need("imageio_ffmpeg")
    keep = "open(sys.argv[-1].removeprefix('file:'), 'wb').write(sys.stdin.buffer.read())"
    program(tmp_path, keep, monkeypatch)
    pictures = gradients(3)
    path = tmp_path / "-film %d.mp4"
    write_video(path, pictures, fps=16)
    assert path.read_bytes() == b"".join(picture.tobytes() for picture in pictures)
    program(tmp_path, "print('one\\nno such codec', file=sys.stderr); sys.exit(1)", monkeypatch)
    with pytest.raises(RaystreamError, match=r"film\.mkv: ffmpeg failed: no such codec$"):
        write_video(tmp_path / "film.mkv", gradients(200))
    assert sorted(p.name for p in tmp_path.iterdir()) == [path.name, "ffmpeg"]


def test_missing_ffmpeg_names_what_installs_it(tmp_path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(RaystreamError, match=r"film.mkv: needs ffmpeg: pip install .*\[video\]"):
        write_video(tmp_path / "film.mkv", gradients(1))


@pytest.mark.parametrize("suffix", [".mp4", ".webm"])
def test_ffmpeg_makes_videos(tmp_path: Path, suffix: str) -> None:
    need("imageio_ffmpeg")
    from imageio_ffmpeg import get_ffmpeg_exe

    path = tmp_path / f"film{suffix}"
    write_video(path, gradients(5, (33, 25)), fps=5)
    command = [get_ffmpeg_exe(), "-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "pipe:1"]
    raw = subprocess.run(command, capture_output=True, check=True).stdout
    assert len(raw) == 5 * 34 * 26 * 3  # sizes are made even


def test_command_line_knows_the_videos() -> None:
    assert frame_files.VIDEOS == VIDEO_SUFFIXES
