"""write_video: encode images as a video, with ffmpeg or Pillow."""

from __future__ import annotations

import contextlib
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
from raystream.rendering.png import png_tag
from raystream.rendering.software_tag import SOFTWARE

#: Suffixes written by ffmpeg; and by Pillow, with its name of the format and the bytes per pixel
#: that it holds in memory until the file is written.
_BY_FFMPEG = (".mp4", ".webm", ".mkv", ".mov")
_BY_PILLOW = {".gif": ("GIF", 1), ".webp": ("WEBP", 3), ".apng": ("PNG", 3)}

#: Suffixes of videos.
VIDEO_SUFFIXES = (*_BY_FFMPEG, *_BY_PILLOW)

#: Shortest GIF frame in hundredths of a second: browsers show shorter ones for ten.
_MIN_GIF_FRAME = 2

Bytes = NDArray[np.uint8]


def check_video(path: str | PathLike[str], size: tuple[int, int], frame_count: int) -> None:
    """Check that a video can be written, before its frames are rendered.

    Parameters
    ----------
    path : str or path
    size : (int, int)
        Width and height in pixels.
    frame_count : int

    Raises
    ------
    ValueError
        If the suffix is not in `VIDEO_SUFFIXES`.
    RaystreamError
        If it needs ffmpeg, and imageio-ffmpeg is not installed.
    MemoryError
        If the frames must fit into memory, and do not.
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
    images: Iterable[Image | Bytes],
    fps: float = 24.0,
    *,
    exposure: float = 1.0,
    tone: str = "linear",
) -> None:
    """Encode images as a video or a looping animation.

    Consecutive equal images may be merged into one that is shown longer.

    Parameters
    ----------
    path : str or path
        ``.gif`` (256 colours per frame, at most 50 frames per second), ``.webp`` or ``.apng``;
        ``.mp4``, ``.webm``, ``.mkv`` or ``.mov`` with the ffmpeg of imageio-ffmpeg (needs
        ``raystream[video]``; ``IMAGEIO_FFMPEG_EXE`` names another one), which chooses the codec.
        Written atomically.
    images : iterable of Image, or of ndarray of shape (H, W, 3), uint8
        All of the same size; arrays are sRGB.
    fps : float
        Frames per second.
    exposure, tone
        As for `Image.save`.

    Raises
    ------
    ValueError
        If the suffix is not supported, there are no images, their sizes differ, or `fps` is not
        above 0.
    RaystreamError
        If ffmpeg is missing or fails; the message contains the last line of its output.
    OSError
        If the file cannot be written.
    """
    target = Path(path)
    if not 0.0 < fps <= 1000.0:
        raise ValueError(f"fps: expected a number above 0, at most 1000, got {fps}")
    check_video(target, (0, 0), 0)
    encoded = _encoded(images, exposure, tone)
    with atomic_write(target) as temporary:
        if target.suffix.lower() in _BY_FFMPEG:
            _write_with_ffmpeg(target, temporary, encoded, fps)
        else:
            _write_with_pillow(temporary, encoded, fps)


def _encoded(images: Iterable[Image | Bytes], exposure: float, tone: str) -> Iterator[Bytes]:
    shape: tuple[int, ...] | None = None
    for image in images:
        array = image.to_bytes(exposure, tone) if isinstance(image, Image) else image
        if array.dtype != np.uint8 or array.ndim != 3 or array.shape[2] != 3:
            raise ValueError(f"images: expected shape (H, W, 3), uint8, got {array.shape}")
        if shape is not None and array.shape != shape:
            raise ValueError(f"images: expected equal sizes, got {shape} and {array.shape}")
        shape = array.shape
        yield array
    if shape is None:
        raise ValueError("images: expected at least one")


def _write_with_pillow(target: Path, arrays: Iterator[Bytes], fps: float) -> None:
    from PIL import ExifTags
    from PIL import Image as Pillow

    kind, _ = _BY_PILLOW[target.suffix.lower()]
    images = [Pillow.fromarray(array) for array in arrays]
    options: dict[str, Any] = {}
    if kind == "GIF":
        images = [image.quantize(256) for image in images]
        ends = [round(100.0 * (i + 1) / fps) for i in range(len(images))]
        lengths = [end - begin for begin, end in zip([0, *ends], ends, strict=False)]
        options["duration"] = [10 * max(_MIN_GIF_FRAME, length) for length in lengths]
        options["disposal"] = 1
        options["comment"] = SOFTWARE.encode()
    elif kind == "WEBP":
        options["duration"] = max(1, round(1000.0 / fps))
        options["quality"] = 90
        exif = Pillow.Exif()
        exif[ExifTags.Base.Software] = SOFTWARE
        options["exif"] = exif.tobytes()
    else:
        options["duration"] = 1000.0 / fps
        options["pnginfo"] = png_tag()
    images[0].save(target, format=kind, save_all=True, append_images=images[1:], loop=0, **options)


def _ffmpeg(target: Path) -> str:
    try:
        import imageio_ffmpeg

        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except (ImportError, RuntimeError):  # the package, or any ffmpeg
        others = " or ".join(_BY_PILLOW)
        raise RaystreamError(
            f"{target}: needs ffmpeg: pip install 'raystream[video]'; {others} does not"
        ) from None


def _write_with_ffmpeg(name: Path, target: Path, arrays: Iterator[Bytes], fps: float) -> None:
    """Pipe raw images to ffmpeg, padded to even sizes, which most codecs need."""
    first = next(arrays)
    height, width, _ = first.shape
    command = [_ffmpeg(name), "-hide_banner", "-loglevel", "error", "-nostdin", "-y"]
    command += ["-f", "rawvideo", "-pix_fmt", "rgb24", "-video_size", f"{width}x{height}"]
    command += ["-framerate", f"{fps:.6f}", "-i", "pipe:0"]
    command += ["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p"]
    command += ["-metadata", f"comment={SOFTWARE}", f"file:{target.absolute()}"]
    with tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=errors
        )
        assert process.stdin is not None
        try:
            is_complete = _write_images(process.stdin, first, arrays)
            code = process.wait()
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()
            with contextlib.suppress(BrokenPipeError):
                process.stdin.close()
        if code != 0 or not is_complete:
            errors.seek(0)
            lines = errors.read()[-4000:].decode(errors="replace").split("\n")
            message = next((line.strip() for line in reversed(lines) if line.strip()), "no reason")
            raise RaystreamError(f"{name}: ffmpeg failed: {message[:300]}")


def _write_images(pipe: IO[bytes], first: Bytes, others: Iterator[Bytes]) -> bool:
    """Write all images to a pipe; return False if ffmpeg stopped reading."""
    try:
        pipe.write(np.ascontiguousarray(first).data)
        for array in others:
            pipe.write(np.ascontiguousarray(array).data)
        pipe.close()
    except BrokenPipeError:
        return False
    return True
