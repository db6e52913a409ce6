"""Video files: pictures in a row, by ffmpeg or by Pillow."""

from __future__ import annotations

import contextlib
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Iterator
from os import PathLike
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.atomic_write import atomic_write
from raystream.core.errors import RaystreamError
from raystream.core.memory import check_memory
from raystream.rendering.image import Image

__all__ = ["VIDEO_SUFFIXES", "check_video", "write_video"]

#: Written by ffmpeg; and by Pillow, with its name for them, and the bytes that it keeps of a
#: pixel until the file is written.
_BY_FFMPEG = (".mp4", ".webm", ".mkv", ".mov")
_BY_PILLOW = {".gif": ("GIF", 1), ".webp": ("WEBP", 3), ".apng": ("PNG", 3)}

#: What the name of a video may end in.
VIDEO_SUFFIXES = (*_BY_FFMPEG, *_BY_PILLOW)

#: A GIF counts hundredths of a second, and browsers show what is shorter than two as ten.
_SHORTEST = 2

Bytes = NDArray[np.uint8]


def check_video(path: str | PathLike[str], size: tuple[int, int], frame_count: int) -> None:
    """Refuse a video that could not be written, before its frames are rendered.

    Parameters
    ----------
    path : str or path
    size : (int, int)
        Width and height in pixels.
    frame_count : int

    Raises
    ------
    ValueError
        If the name ends in something else than `VIDEO_SUFFIXES`.
    RaystreamError
        If it needs ffmpeg, and there is none.
    MemoryError
        If the frames do not fit into memory, where they have to.
    """
    target = Path(path)
    suffix = target.suffix.lower()
    if suffix not in VIDEO_SUFFIXES:
        raise ValueError(f"{target}: the name must end in {' or '.join(VIDEO_SUFFIXES)}")
    if suffix in _BY_FFMPEG:
        _ffmpeg(target)
        return
    _, bytes_per_pixel = _BY_PILLOW[suffix]
    what = f"{target}: {frame_count:,} frames of {size[0]}x{size[1]} would"
    check_memory(size[0] * size[1] * frame_count * bytes_per_pixel, what)


def write_video(
    path: str | PathLike[str],
    pictures: Iterable[Image | Bytes],
    fps: float = 24.0,
    *,
    exposure: float = 1.0,
    tone: str = "linear",
) -> None:
    """Write pictures to a file that shows them one after another, again and again.

    Equal pictures in a row may become one that stays longer.

    Parameters
    ----------
    path : str or path
        ``.gif`` (256 colours a frame, at most 50 frames a second), ``.webp`` or ``.apng``;
        ``.mp4``, ``.webm``, ``.mkv`` or ``.mov`` if there is ffmpeg on ``PATH``, which chooses
        the codec. The file appears, or is replaced, as a whole.
    pictures : iterable of Image, or of ndarray of shape (H, W, 3), uint8
        All of one size; arrays are sRGB.
    fps : float
        Pictures in a second.
    exposure, tone
        As for `Image.save`.

    Raises
    ------
    ValueError
        If the name ends in something else, there is no picture, their sizes differ, or `fps`
        is not above 0.
    RaystreamError
        If there is no ffmpeg, or it fails: with the last thing that it said.
    OSError
        If the file cannot be written.
    """
    target = Path(path)
    if not 0.0 < fps <= 1000.0:
        raise ValueError(f"fps: expected a number above 0, at most 1000, got {fps}")
    check_video(target, (0, 0), 0)
    encoded = _encoded(pictures, exposure, tone)
    with atomic_write(target) as temporary:
        if target.suffix.lower() in _BY_FFMPEG:
            _by_ffmpeg(target, temporary, encoded, fps)
        else:
            _by_pillow(temporary, encoded, fps)


def _encoded(pictures: Iterable[Image | Bytes], exposure: float, tone: str) -> Iterator[Bytes]:
    shape: tuple[int, ...] | None = None
    for picture in pictures:
        array = picture.to_bytes(exposure, tone) if isinstance(picture, Image) else picture
        if array.dtype != np.uint8 or array.ndim != 3 or array.shape[2] != 3:
            raise ValueError(f"pictures: expected shape (H, W, 3), uint8, got {array.shape}")
        if shape is not None and array.shape != shape:
            raise ValueError(f"pictures: expected all of one size, got {shape} and {array.shape}")
        shape = array.shape
        yield array
    if shape is None:
        raise ValueError("pictures: expected at least one")


def _by_pillow(target: Path, arrays: Iterator[Bytes], fps: float) -> None:
    from PIL import Image as Pillow

    kind, _ = _BY_PILLOW[target.suffix.lower()]
    images = [Pillow.fromarray(array) for array in arrays]
    options: dict[str, Any] = {}
    if kind == "GIF":
        images = [image.quantize(256) for image in images]
        ends = [round(100.0 * (i + 1) / fps) for i in range(len(images))]
        lengths = [end - begin for begin, end in zip([0, *ends], ends, strict=False)]
        options["duration"] = [10 * max(_SHORTEST, length) for length in lengths]
        options["disposal"] = 1
    else:
        options["duration"] = 1000.0 / fps if kind == "PNG" else max(1, round(1000.0 / fps))
    if kind == "WEBP":
        options["quality"] = 90
    images[0].save(target, format=kind, save_all=True, append_images=images[1:], loop=0, **options)


def _ffmpeg(target: Path) -> str:
    program = shutil.which("ffmpeg")
    if program is None:
        others = " or ".join(_BY_PILLOW)
        raise RaystreamError(f"{target}: needs ffmpeg, which is not on PATH; {others} does not")
    return program


def _by_ffmpeg(name: Path, target: Path, arrays: Iterator[Bytes], fps: float) -> None:
    """Send raw pictures to ffmpeg; most codecs want even sizes."""
    first = next(arrays)
    height, width, _ = first.shape
    command = [_ffmpeg(name), "-hide_banner", "-loglevel", "error", "-nostdin", "-y"]
    command += ["-f", "rawvideo", "-pix_fmt", "rgb24", "-video_size", f"{width}x{height}"]
    command += ["-framerate", f"{fps:.6f}", "-i", "pipe:0"]
    command += ["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p"]
    command += [f"file:{target.absolute()}"]
    with tempfile.TemporaryFile() as complaints:
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=complaints
        )
        assert process.stdin is not None
        try:
            whole = _fed(process.stdin, first, arrays)
            code = process.wait()
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()
            with contextlib.suppress(BrokenPipeError):
                process.stdin.close()
        if code != 0 or not whole:
            complaints.seek(0)
            lines = complaints.read()[-4000:].decode(errors="replace").split("\n")
            said = next((line.strip() for line in reversed(lines) if line.strip()), "no reason")
            raise RaystreamError(f"{name}: ffmpeg failed: {said[:300]}")


def _fed(pipe: IO[bytes], first: Bytes, others: Iterator[Bytes]) -> bool:
    """Write all pictures; False if ffmpeg stopped reading."""
    try:
        pipe.write(np.ascontiguousarray(first).data)
        for array in others:
            pipe.write(np.ascontiguousarray(array).data)
        pipe.close()
    except BrokenPipeError:
        return False
    return True
