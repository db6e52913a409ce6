"""The kernels that exported pages have of a structure."""

from __future__ import annotations

import pytest

import raystream as rs
from raystream.graphics.shader_source import shader_files
from raystream.structures import names_with
from raystream.web.pass_kernels import pass_files, pass_kernels, schedule


@pytest.fixture(scope="module")
def scene():
    return rs.load("cornell")


def test_structures_with_passes_are_the_multipass_machine_s(scene):
    for name in names_with("graphics"):
        made = pass_kernels(rs.Tracer(scene, name).structure)
        assert (made is not None) == (name in names_with("graphics multipass")), name


@pytest.mark.parametrize(
    ("traversal", "file"),
    [
        ("stack", "kdtree/restart.wgsl"),
        ("short-stack", "kdtree/restart.wgsl"),
        ("restart", "kdtree/restart.wgsl"),
        ("backtrack", "kdtree/backtrack.wgsl"),
    ],
)
def test_trees_with_stacks_restart(scene, traversal, file):
    structure = rs.Tracer(scene, "kdtree", traversal=traversal).structure
    made = pass_kernels(structure)
    assert made["instead"]["kdtree/stack.wgsl"] == file
    assert structure.options.traversal == traversal
    assert file in pass_files(made)


def test_all_rays_are_shaded(scene):
    states = schedule()["states"]
    first, *others = pass_kernels(rs.Tracer(scene, "grid").structure)["kernels"]
    assert first["next"] == [states["traversing"], states["shading"]]
    assert [one["name"] for one in others] == ["traverse", "intersect"]
    sources = shader_files(pass_files(pass_kernels(rs.Tracer(scene, "grid").structure)))
    for one in (first, *others):
        assert f"fn {one['entry']}(" in sources["multipass/grid.wgsl"]
        assert one["state"] in states.values()
