"""A structure from outside the package: everything that works once it is registered."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import raystream as rs
from cases import CASES
from conftest import assert_same_bits
from raystream.cli import main
from raystream.core.npz import read_npz, write_npz
from raystream.structures import STRUCTURES
from raystream.viewer.capabilities import hello
from raystream.viewer.settings import Settings
from slabs import Slabs
from test_agreement import assert_expected_of, case_of, expected_of, rays_of


@pytest.fixture(autouse=True, scope="module")
def _registered() -> Iterator[None]:
    rs.register_structure(Slabs)
    yield
    del STRUCTURES["slabs"]


@pytest.fixture
def scene() -> rs.Scene:
    return rs.load("cornell")


@pytest.mark.parametrize("name", CASES)
def test_slabs_equal_brute_force(name):
    case = case_of(name)
    tracer = rs.Tracer(case.scene, Slabs(slab_count=5))
    assert_expected_of(tracer, rays_of(case), expected_of(name))


def test_one_slab_and_one_for_each_triangle():
    case = case_of("closed_mesh")
    for count in (1, 1024):
        tracer = rs.Tracer(case.scene, "slabs", slab_count=count)
        assert tracer.structure.quality() == {"slabs": min(count, case.scene.triangle_count)}
        assert_expected_of(tracer, rays_of(case), expected_of("closed_mesh"), is_brief=True)


def test_no_triangles_at_all():
    tracer = rs.Tracer(rs.Scene(), Slabs())
    assert not tracer.first_hit(np.zeros((5, 3)), np.ones((5, 3))).is_hit.any()


def test_options_are_checked(scene):
    with pytest.raises(ValueError, match="slab_count: expected 1 to 1024, got 0"):
        Slabs(slab_count=0)
    with pytest.raises(TypeError, match="slabs: has no option 'size'; it has slab_count"):
        rs.Tracer(scene, "slabs", size=3)
    with pytest.raises(TypeError, match="slabs: give 'slab_count' as an argument of Slabs"):
        rs.Tracer(scene, Slabs(), slab_count=3)


def test_fewer_triangles_are_tested_than_by_brute_force(scene):
    rays = scene.camera.rays(16, 12)
    tracer = rs.Tracer(scene, Slabs(slab_count=6), counters=True)
    tracer.first_hit(*rays)
    assert (tracer.counters.steps == 6).all()
    assert_same_bits(tracer.counters.cells, tracer.counters.leaves)
    assert tracer.counters.tests.mean() < scene.triangle_count


def test_what_it_lacks_is_said(scene):
    with pytest.raises(ValueError, match=r"'multipass' supports the structures .*, not 'slabs'"):
        rs.Tracer(scene, "slabs", machine="multipass")


def test_moved_triangles_and_files(scene, tmp_path):
    tracer = rs.Tracer(scene, Slabs(slab_count=3))
    tracer.update([mesh.vertices + [0, 0, 8] for mesh in scene.meshes])
    assert tracer.structure.options == Slabs(slab_count=3)
    rays = scene.camera.rays(16, 12)
    tracer.save(tmp_path / "slabs.npz")
    loaded = rs.Tracer.load(tmp_path / "slabs.npz")
    assert loaded.structure.options == Slabs(slab_count=3)
    assert_same_bits(loaded.first_hit(*rays).t, tracer.first_hit(*rays).t)


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("prim_ids", lambda a: a[::2], "list each triangle once"),
        ("prim_ids", lambda a: a * 0, "list each triangle once"),
        ("prim_ids", lambda a: a.astype(np.int64), "'prim_ids' has dtype int64"),
        ("splits", lambda a: a[::-1].copy(), "do not delimit"),
        ("splits", lambda a: a[:0], "do not delimit"),
        ("splits", lambda a: a + 1, "do not delimit"),
        ("splits", lambda a: np.insert(a, -1, np.uint64(10**6)), "do not delimit"),
    ],
)
def test_hostile_files_are_refused(scene, tmp_path, name, change, words):
    rs.Tracer(scene, "slabs").save(tmp_path / "slabs.npz")
    arrays = read_npz(tmp_path / "slabs.npz")
    arrays[f"structure.{name}"] = change(arrays[f"structure.{name}"])
    write_npz(tmp_path / "slabs.npz", arrays)
    with pytest.raises(rs.FileFormatError, match=words):
        rs.Tracer.load(tmp_path / "slabs.npz")


def test_the_command_line_takes_its_name(tmp_path: Path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    np.savez(
        "rays.npz", origins=np.full((4, 3), [278.0, 273.0, -800.0]), directions=np.eye(4)[:, 1:]
    )
    commands = (
        ["query", "cornell", "rays.npz", "-o", "hits.npz", "--structure", "slabs", "--json"],
        ["render", "cornell", "-o", "x.png", "--size", "8x6", "--structure", "slabs", "--json"],
    )
    for command in (*commands, [*commands[0], "--option", "slab_count=4"]):
        with pytest.raises(SystemExit) as ended:
            main(command)
        output = capsys.readouterr()
        assert ended.value.code in (0, None), output.err
        assert json.loads(output.out)["structure"] == "slabs"
    with pytest.raises(SystemExit):
        main([*commands[0], "--option", "slab_count=0"])
    assert "slab_count: expected 1 to 1024, got 0" in capsys.readouterr().err


def test_the_viewer_lists_it(scene):
    assert {"name": "slabs", "traversals": []} in hello()["structures"]
    settings = Settings().changed({"structure": "slabs"})
    assert rs.Tracer(scene, **settings.tracer_key.options).structure.name == "slabs"


def test_a_name_is_taken_once():
    class Bvh(Slabs):
        name = "bvh"

    with pytest.raises(ValueError, match="'bvh' is registered already"):
        rs.register_structure(Bvh)
