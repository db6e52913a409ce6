"""Triangles that move between cells: the lists equal those of a rebuilt grid."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from conftest import assert_same_bits
from meshes import soup
from raystream.structures.grid.build import build_lists
from test_agreement import assert_same_answers
from test_update import rays_at


def assert_lists_as_built(structure):
    lists = build_lists(structure.triangles, structure.lattice, 2**32 - 1, "resolution")
    assert_same_bits(structure.lists.splits, lists.splits)
    assert_same_bits(structure.lists.references, lists.references)


@pytest.mark.parametrize("levels", [1, 2])
def test_lists_follow_triangles(levels, rng):
    vertices, faces = soup(300, 5)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces), "grid", resolution=4, levels=levels)
    kept = rng.integers(0, 900, 30)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    oracle = rs.Tracer(tracer.scene, "brute")
    rays = rays_at(vertices, rng)
    for step in range(8):
        moved = vertices.copy()
        which = rng.integers(0, 900, (0, 3, 40, 900)[step % 4])
        moved[which] += rng.normal(size=(len(which), 3)) * 0.3
        moved[kept] = np.clip(moved[kept], low, high)
        moved = np.clip(moved, low, high)
        if step % 2:
            moved[rng.integers(0, 900, 5)] = np.nan
        report = tracer.update(moved, max_cost_growth=np.inf)
        oracle.update(moved)
        assert not report.rebuilt
        assert report.cost > 0
        assert_lists_as_built(tracer.structure)
        assert_same_answers(tracer, oracle, rays)


def test_lists_are_built_anew_when_the_box_does_not_do(rng):
    vertices, faces = soup(300, 5)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces), "grid")
    middle = vertices.mean(axis=0)
    assert tracer.update(vertices * 1.5).rebuilt
    assert not tracer.update(vertices, max_cost_growth=np.inf).rebuilt
    assert tracer.update(middle + (vertices - middle) * 0.1).rebuilt  # a corner of the box
    assert tracer.update(vertices, max_cost_growth=0).rebuilt
    assert tracer.update(np.full_like(vertices, np.nan)).rebuilt
    assert not tracer.any_hit([0, 0, 0], [1, 1, 1])
    assert tracer.update(vertices).rebuilt


def test_a_moved_grid_in_a_file(tmp_path, rng):
    vertices, faces = soup(300, 5)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces), "grid", levels=2)
    inner = vertices * 0.9 + vertices.mean(axis=0) * 0.1
    assert not tracer.update(inner).rebuilt
    tracer.save(tmp_path / "x.npz")
    loaded = rs.Tracer.load(tmp_path / "x.npz")
    assert loaded.structure.lattice == tracer.structure.lattice
    assert_same_answers(loaded, tracer, rays_at(vertices, rng))
    assert not loaded.update(inner * 0.99 + vertices.mean(axis=0) * 0.01).rebuilt
    assert_lists_as_built(loaded.structure)
