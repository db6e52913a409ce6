"""Samples: public models by name, from a local folder or downloaded with a checksum."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from importlib.resources import files
from pathlib import Path, PurePosixPath
from types import MappingProxyType
from typing import Any, NamedTuple

from raystream.core.cache_folder import cache_folder
from raystream.core.errors import RaystreamError
from raystream.scene.camera import Camera

#: Environment variable for the folder of the samples' files.
SCENES_VARIABLE = "RAYSTREAM_SCENES"

#: Called with the number of files done and the total.
Progress = Callable[[int, int], object]


class SampleFile(NamedTuple):
    """One file of a sample.

    Parameters
    ----------
    path : str
        Relative to the samples' folder, with forward slashes.
    sha256 : str
        Checksum of its bytes, 64 hexadecimal digits.
    url : str or None
        Address of exactly these bytes; None if published only inside an archive.
    """

    path: str
    sha256: str
    url: str | None


class Sample(NamedTuple):
    """A public model.

    Parameters
    ----------
    name : str
    main : str
        The file to load, within the samples' folder.
    files : tuple of SampleFile
        The main file, and the files that it refers to.
    triangles : int
        Number of triangles.
    credit, licence : str
        Authors, and terms of use, as far as known.
    published : str
        Web page.
    camera : Camera
        A view of the model, for images of 4:3.
    """

    name: str
    main: str
    files: tuple[SampleFile, ...]
    triangles: int
    credit: str
    licence: str
    published: str
    camera: Camera

    @property
    def can_be_fetched(self) -> bool:
        """Whether all of its files can be downloaded one by one."""
        return all(file.url for file in self.files)


def _read_samples() -> Mapping[str, Sample]:
    text = files("raystream.scene").joinpath("samples.json").read_text(encoding="utf-8")
    return MappingProxyType(
        {name: _sample(name, record) for name, record in json.loads(text).items()}
    )


def _sample(name: str, record: dict[str, Any]) -> Sample:
    base = record["base_url"]
    listed = tuple(
        SampleFile(path, file["sha256"], base + file["path"] if base else None)
        for path, file in record["files"].items()
    )
    return Sample(
        name,
        record["main"],
        listed,
        record["triangles"],
        record["credit"],
        record["licence"],
        record["published"],
        Camera(**record["camera"]),
    )


#: The samples by name.
SAMPLES: Mapping[str, Sample] = _read_samples()


def fetch(name: str, progress: Progress | None = None) -> Path:
    """Find a sample's main file, downloading the sample if necessary.

    Searches the folder in the environment variable ``RAYSTREAM_SCENES`` first: its files are
    used as they are, compressed with gzip or not. Then raystream's cache folder, into which
    files are downloaded and verified against their checksums.

    Parameters
    ----------
    name : str
        A key of `SAMPLES`.
    progress : callable, optional
        Called during a download with the number of files done and the total.

    Returns
    -------
    Path
        The file to load, with the files that it refers to in place. For the view
        that goes with it, see `camera`.

    Raises
    ------
    ValueError
        If there is no such sample.
    RaystreamError
        If the sample is not found and cannot be downloaded: a message of one line.
    """
    sample = _known(name)
    found = _in_scenes_folder(sample)
    if found is not None:
        return found
    folder = cache_folder() / "samples"
    if all((folder / file.path).is_file() for file in sample.files):
        return folder / sample.main
    if not sample.can_be_fetched:
        raise RaystreamError(
            f"sample {name!r} cannot be downloaded automatically: get it from {sample.published}, "
            f"and set {SCENES_VARIABLE} to the folder that holds {sample.main}"
        )
    _download(sample, folder, progress)
    return folder / sample.main


def camera(name: str) -> Camera | None:
    """Return the default view of a sample, for files without a camera.

    Parameters
    ----------
    name : str
        Any name; the result is None if it is not a sample.
    """
    sample = SAMPLES.get(name)
    return None if sample is None else sample.camera


def _known(name: str) -> Sample:
    if name not in SAMPLES:
        raise ValueError(f"no sample {name!r}: expected one of {', '.join(SAMPLES)}")
    return SAMPLES[name]


def _in_scenes_folder(sample: Sample) -> Path | None:
    chosen = os.environ.get(SCENES_VARIABLE)
    if not chosen:
        return None
    folder = Path(chosen).expanduser()
    if not folder.is_dir():
        raise RaystreamError(f"{SCENES_VARIABLE}: folder {chosen} does not exist")
    path = folder / sample.main
    for candidate in (path, path.with_suffix("") if path.suffix == ".gz" else path):
        if candidate.is_file():
            return candidate
    return None


def _download(sample: Sample, folder: Path, progress: Progress | None) -> None:
    try:
        import pooch
    except ImportError:
        raise RaystreamError(
            f"sample {sample.name!r} must be downloaded: pip install raystream[samples], or set "
            f"{SCENES_VARIABLE} to a folder that holds {sample.main}"
        ) from None
    for done, file in enumerate(sample.files):
        if progress is not None:
            progress(done, len(sample.files))
        place = PurePosixPath(file.path)
        try:
            pooch.retrieve(
                file.url,
                known_hash=f"sha256:{file.sha256}",
                fname=place.name,
                path=folder / place.parent,
            )
        except (OSError, ValueError) as error:  # no network or disk, or a wrong checksum
            reason = " ".join(str(error).split()) or type(error).__name__
            raise RaystreamError(
                f"sample {sample.name!r}: could not download {file.url} ({reason})"
            ) from error
    if progress is not None:
        progress(len(sample.files), len(sample.files))
