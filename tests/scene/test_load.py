"""load: files, built-in scenes and samples by name, and errors of one line."""

from __future__ import annotations

import gzip
import warnings
from pathlib import Path

import numpy as np
import pytest

from raystream.core.errors import FileFormatError, RaystreamWarning
from raystream.scene import procedural, samples
from raystream.scene.io import formats
from raystream.scene.load import load
from raystream.scene.scene import Scene
from scene.io import tiny


@pytest.fixture
def bunny(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of samples with a fake bunny."""
    path = tmp_path / samples.SAMPLES["bunny"].main
    path.parent.mkdir(parents=True)
    path.write_bytes(tiny.ply_text())
    monkeypatch.setenv(samples.SCENES_VARIABLE, str(tmp_path))
    return path


@pytest.mark.parametrize("name", tiny.ALL)
@pytest.mark.parametrize("packed", [False, True])
def test_every_format(tmp_path: Path, name: str, packed: bool) -> None:
    path = tmp_path / (name.upper() + ".gz" if packed else name)
    path.write_bytes(gzip.compress(tiny.ALL[name]) if packed else tiny.ALL[name])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RaystreamWarning)  # missing textures
        plain, text = load(path), load(str(path))
    assert plain.triangle_count == text.triangle_count > 0
    assert plain.name == path.name


def test_files_win_over_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bunny: Path) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "forest.off").write_bytes(tiny.OFF)
    assert load("forest.off").triangle_count == 4
    assert load("./forest.off").triangle_count == 4
    (tmp_path / "cornell").mkdir()
    assert load("cornell").triangle_count > 4  # without a suffix it is a name


@pytest.mark.parametrize("name", ["cornell", "forest"])
def test_built_in_scenes(name: str) -> None:
    few, many = load(f"{name}:2000"), load(name, triangles=20_000)
    assert 200 < few.triangle_count < many.triangle_count
    np.testing.assert_array_equal(
        few.meshes[0].vertices, procedural.generate(name, 2000).meshes[0].vertices
    )
    assert load(f"{name}:2_000").triangle_count == few.triangle_count


def test_samples_come_with_a_view(bunny: Path) -> None:
    scene = load("bunny")
    assert scene.triangle_count == 4
    assert scene.camera == samples.SAMPLES["bunny"].camera


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        ("forrest", "did you mean 'forest'"),
        ("BUNNY", "did you mean 'bunny'"),
        ("", "^'': is neither a built-in scene nor a sample"),
        (".", "is a folder"),
        ("..", "is a folder"),
        ("zzz", "Samples: bunny.*Files: .obj .ply"),
        ("forest:", "expected a number of triangles"),
        ("forest:many", "expected a number of triangles"),
        ("forest:-5", "expected a number of triangles"),
        ("forest:0", "expected a number of triangles"),
        ("bunny.ply", "no such file; did you mean 'bunny'"),
        ("none.obj", "no such file"),
        ("no/such/folder", "no such file"),
        ("a\0b.obj", "no such file"),
        ("x" * 5000 + ".obj", "no such file"),
        (Path("forest"), "no such file"),
    ],
)
def test_what_is_not_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, source: str | Path, reason: str
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FileFormatError, match=reason) as caught:
        load(source)
    assert "\n" not in str(caught.value)


def test_folders_and_unknown_suffixes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("d.obj", "models"):
        Path(name).mkdir()
        for source in (name, f"{name}/", f"./{name}", Path(name), tmp_path / name):
            with pytest.raises(FileFormatError, match="is a folder"):
                load(source)
    (tmp_path / "a.fbx").touch()
    with pytest.raises(FileFormatError, match=r"supported: \.obj"):
        load(tmp_path / "a.fbx")


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.obj", b"v 0 0 0\n"),
        ("a.obj", b"# nothing\n"),
        ("a.obj", b"o empty\n"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nl 1 2\n"),
        ("a.nff", b"l 1 2 3\n"),
        ("a.gltf", b'{"asset": {"version": "2.0"}}'),
        ("a.ply", tiny.ply_text().partition(b"element face")[0] + b"end_header\n" + b"0 " * 12),
        ("a.off", b"OFF\n1 0 0\n0 0 0\n"),
        ("a.off", b"OFF 0 0 0\n"),
        ("a.stl", b"solid empty\nendsolid empty\n"),
        ("a.stl", b"\0" * 84),
    ],
)
def test_files_without_triangles_are_empty_scenes(
    tmp_path: Path, name: str, content: bytes
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.warns(RaystreamWarning, match="holds no triangles") as caught:
        scene = load(tmp_path / name)
    assert len(caught) == 1
    assert scene.triangle_count == 0
    assert scene.camera is not None


def test_triangles_that_cannot_be_hit_warn_once(tmp_path: Path) -> None:
    path = tmp_path / "a.off"
    path.write_text(
        "OFF 5 4 0\n0 0 0\n1 0 0\n0 1 0\nnan 0 0\ninf 0 0\n3 0 1 2\n3 0 1 3\n3 0 1 4\n3 1 1 2\n"
    )
    with pytest.warns(RaystreamWarning, match="without area, 2 with a non-finite") as caught:
        scene = load(path)
    assert len(caught) == 1
    assert str(path) in str(caught[0].message)
    assert scene.triangle_count == 4
    assert scene.skipped_count == 3


def test_time_is_for_animated_files(tmp_path: Path) -> None:
    path = tmp_path / "a.aff"
    path.write_text("x a { p 3 0 0 0 1 0 0 0 1 0 } k a { transl 2 0 0 0 0 0 0 0 4 8 0 0 0 0 0 }")
    assert load(path, time=2.0).meshes[0].vertices[0].tolist() == [4, 0, 0]
    (tmp_path / "a.off").write_bytes(tiny.OFF)
    for source in (tmp_path / "a.off", "forest"):
        with pytest.raises(ValueError, match="animated"):
            load(source, time=1.0)
    with pytest.raises(ValueError, match="finite"):
        load(path, time=float("nan"))


def test_triangles_are_for_built_in_scenes(tmp_path: Path, bunny: Path) -> None:
    (tmp_path / "a.off").write_bytes(tiny.OFF)
    for source in (tmp_path / "a.off", "bunny"):
        with pytest.raises(ValueError, match="only for built-in scenes"):
            load(source, triangles=100)
    with pytest.raises(ValueError, match="given twice"):
        load("forest:100", triangles=100)
    with pytest.raises(TypeError, match="text or a path"):
        load(b"a.obj")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (MemoryError(), "memory"),
        (RecursionError("too\ndeep"), "RecursionError: too deep"),
        (KeyError("x"), "cannot be read as .off"),
    ],
)
def test_what_no_reader_expected_is_one_line_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception, reason: str
) -> None:
    def fail(path: Path) -> Scene:
        raise error

    monkeypatch.setattr("raystream.scene.io.off.read_off", fail)
    path = tmp_path / "a.off"
    path.write_bytes(tiny.OFF)
    with pytest.raises(FileFormatError, match=reason) as caught:
        formats.read_model(path)
    assert "\n" not in str(caught.value)


def test_warnings_that_were_made_errors_stay_warnings(tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2 4\n")
    with warnings.catch_warnings():
        warnings.simplefilter("error", RaystreamWarning)
        with pytest.raises(RaystreamWarning, match="dropped: 1 triangles"):
            load(path)
