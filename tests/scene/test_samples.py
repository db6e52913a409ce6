"""Samples: found in a folder, in the cache, or downloaded; never at import."""

from __future__ import annotations

import builtins
import hashlib
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from raystream.core.errors import RaystreamError
from raystream.scene import samples
from raystream.scene.camera import Camera
from raystream.scene.samples import SAMPLES, Sample, SampleFile, fetch

TINY = Sample(
    "tiny",
    "tiny/a/main.aff",
    (
        SampleFile("tiny/a/main.aff", hashlib.sha256(b"main").hexdigest(), "https://x.test/main"),
        SampleFile("tiny/b/wood.ppm", hashlib.sha256(b"wood").hexdigest(), "https://x.test/wood"),
    ),
    1,
    "nobody",
    "any",
    "https://x.test",
    Camera((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)),
)


@pytest.fixture(autouse=True)
def places(tmp_path, monkeypatch):
    """An empty cache, no folder of scenes, a sample of two files, and no network."""
    monkeypatch.setenv("RAYSTREAM_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.delenv("RAYSTREAM_SCENES", raising=False)
    monkeypatch.setattr(samples, "SAMPLES", {**SAMPLES, "tiny": TINY})
    monkeypatch.setitem(sys.modules, "pooch", SimpleNamespace(retrieve=no_network))
    return tmp_path


def no_network(url, **_):
    raise ConnectionError(f"no route\nto {url}")


def retrieve_from(contents):
    """A stand-in for pooch.retrieve that has these contents by URL."""

    def retrieve(url, known_hash, fname, path):
        content = contents[url]
        if f"sha256:{hashlib.sha256(content).hexdigest()}" != known_hash:
            raise ValueError(f"hash of {fname} does not match")
        Path(path).mkdir(parents=True, exist_ok=True)
        (Path(path) / fname).write_bytes(content)

    return retrieve


def write(folder, path, content=b"x"):
    (folder / path).parent.mkdir(parents=True, exist_ok=True)
    (folder / path).write_bytes(content)


@pytest.mark.parametrize("name", SAMPLES)
def test_records_are_whole(name):
    sample = SAMPLES[name]
    assert sample.name == name
    assert sample.main in [file.path for file in sample.files]
    assert sample.triangles > 0
    assert all((sample.credit, sample.licence))
    assert sample.published.startswith("https://")
    assert samples.camera(name) == sample.camera
    for file in sample.files:
        assert not Path(file.path).is_absolute()
        assert ".." not in Path(file.path).parts
        assert len(bytes.fromhex(file.sha256)) == 32
        if file.url is not None:  # pinned: a branch's bytes would change
            host, *rest = file.url.removeprefix("https://").split("/")
            assert host == "raw.githubusercontent.com"
            assert len(bytes.fromhex(rest[2])) == 20
            assert rest[-1] == Path(file.path).name


def test_the_papers_models_can_be_fetched():
    for name, count in (("bunny", 69_451), ("kitchen", 110_561), ("bart_robots", 71_708)):
        assert SAMPLES[name].can_be_fetched
        assert SAMPLES[name].triangles == count


def test_built_in_scenes_and_samples_have_names_of_their_own():
    from raystream.scene.procedural import BUILTIN

    assert not set(BUILTIN) & set(SAMPLES)


def test_samples_that_are_there_need_neither_pooch_nor_numba(places):
    write(places / "cache" / "samples", SAMPLES["bunny"].main)
    code = (
        "import sys; from raystream.scene import samples; samples.fetch('bunny'); "
        "assert not {'pooch', 'requests', 'numba'} & set(sys.modules)"
    )
    source = Path(samples.__file__).parents[2]
    subprocess.run([sys.executable, "-c", code], check=True, cwd=source)


def test_folder_of_scenes_comes_first(places, monkeypatch):
    write(places / "cache" / "samples", "tiny/a/main.aff")
    write(places / "cache" / "samples", "tiny/b/wood.ppm")
    write(places / "mine", "tiny/a/main.aff")
    monkeypatch.setenv("RAYSTREAM_SCENES", str(places / "mine"))
    assert fetch("tiny") == places / "mine" / "tiny/a/main.aff"


@pytest.mark.parametrize("suffix", [".gz", ""])
def test_folder_of_scenes_may_hold_packed_or_plain_files(places, monkeypatch, suffix):
    write(places, f"sponza/sponza.obj{suffix}")
    monkeypatch.setenv("RAYSTREAM_SCENES", str(places))
    assert fetch("sponza") == places / f"sponza/sponza.obj{suffix}"


def test_missing_folder_of_scenes_is_an_error(places, monkeypatch):
    monkeypatch.setenv("RAYSTREAM_SCENES", str(places / "nowhere"))
    with pytest.raises(RaystreamError, match=r"RAYSTREAM_SCENES: folder .*nowhere does not exist"):
        fetch("bunny")


def test_cached_sample_is_used_without_pooch(places, monkeypatch):
    write(places / "cache" / "samples", "tiny/a/main.aff")
    write(places / "cache" / "samples", "tiny/b/wood.ppm")
    without_pooch(monkeypatch)
    assert fetch("tiny") == places / "cache/samples/tiny/a/main.aff"


def test_download_puts_every_file_where_it_belongs(places, monkeypatch):
    contents = {"https://x.test/main": b"main", "https://x.test/wood": b"wood"}
    fake = SimpleNamespace(retrieve=retrieve_from(contents))
    monkeypatch.setitem(sys.modules, "pooch", fake)
    monkeypatch.setenv("RAYSTREAM_SCENES", str(places))  # lacks the sample: search further
    steps = []
    path = fetch("tiny", progress=lambda done, count: steps.append((done, count)))
    assert path.read_bytes() == b"main"
    assert (places / "cache/samples/tiny/b/wood.ppm").read_bytes() == b"wood"
    assert steps == [(0, 2), (1, 2), (2, 2)]


def test_interrupted_download_goes_on(places, monkeypatch):
    contents = {"https://x.test/main": b"main"}
    monkeypatch.setitem(
        sys.modules,
        "pooch",
        SimpleNamespace(retrieve=retrieve_from(contents | {"https://x.test/wood": b"bad"})),
    )
    with pytest.raises(RaystreamError, match=r"could not download https://x.test/wood"):
        fetch("tiny")
    contents["https://x.test/wood"] = b"wood"
    monkeypatch.setitem(sys.modules, "pooch", SimpleNamespace(retrieve=retrieve_from(contents)))
    assert fetch("tiny").read_bytes() == b"main"


def test_no_network_is_one_clear_line():
    with pytest.raises(RaystreamError) as caught:
        fetch("bunny")
    assert "\n" not in str(caught.value)
    assert "could not download https://raw.githubusercontent.com" in str(caught.value)
    assert "no route to" in str(caught.value)


def without_pooch(monkeypatch):
    real = builtins.__import__

    def fail(name, *args, **kwargs):
        if name == "pooch":
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.delitem(sys.modules, "pooch", raising=False)
    monkeypatch.setattr(builtins, "__import__", fail)


def test_missing_pooch_says_what_to_install(monkeypatch):
    without_pooch(monkeypatch)
    with pytest.raises(RaystreamError, match=r"pip install raystream\[samples\]"):
        fetch("bunny")


@pytest.mark.parametrize("name", [name for name in SAMPLES if not SAMPLES[name].can_be_fetched])
def test_samples_in_archives_say_where_they_are(name):
    with pytest.raises(RaystreamError, match="RAYSTREAM_SCENES") as caught:
        fetch(name)
    assert SAMPLES[name].published in str(caught.value)
    assert "\n" not in str(caught.value)


def test_unknown_samples_are_refused():
    with pytest.raises(ValueError, match=r"no sample 'dragon'.*bunny"):
        fetch("dragon")
    assert samples.camera("dragon") is None
