"""Cut-outs in visibility, view factors and visible faces, against cards without that half."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from cards import DOWN, KINDS, card, cut_out, faded, over_ground
from conftest import assert_same_bits

#: The others need kernels of their own.
PLACED = [False, pytest.param(True, marks=pytest.mark.ci)]

ABOVE = [[-0.5, 0.3, 1.0], [0.5, 0.3, 1.0]]
BELOW = [[-0.5, 0.3, -0.5], [0.5, 0.3, -0.5]]


# Visibility


@pytest.mark.parametrize("placed", PLACED)
@pytest.mark.parametrize("kind", KINDS)
def test_points_see_each_other_through_holes(kind, placed) -> None:
    tracer = rs.Tracer(over_ground(kind, placed))
    assert rs.visibility(tracer, ABOVE, BELOW).tolist() == [[True, False], [True, False]]
    assert not rs.visibility(tracer, ABOVE, BELOW, cutouts=False).any()
    # One set of points: half of the segments are traced.
    both = rs.visibility(tracer, ABOVE + BELOW)
    assert both.sum() == 4 + 4 + 4
    assert (both == both.T).all()


@pytest.mark.parametrize("kind", KINDS)
def test_holes_are_seen_through_in_float64_and_beside_spheres(kind) -> None:
    double = rs.Tracer(over_ground(kind), precision="float64")
    clear = rs.Scene.spheres([[-0.5, 0.3, 0.0]], 0.2, materials=[rs.Material(opacity=0.3)])
    beside = rs.Tracer(rs.Scene.combine([over_ground(kind), clear]))
    for tracer in (double, beside):
        assert rs.visibility(tracer, ABOVE, BELOW).tolist() == [[True, False], [True, False]]
        assert not rs.visibility(tracer, ABOVE, BELOW, cutouts=False).any()
        assert rs.visibility(tracer, ABOVE, BELOW, skip_a=[[0, 1, 2, 3]] * 2).all()


def test_many_points_see_what_they_see_past_half_a_card(rng) -> None:
    a = np.column_stack([rng.uniform(-1.5, 1.5, (60, 2)), rng.uniform(0.2, 1.0, 60)])
    b = a * [1.0, 1.0, -0.9]
    whole, half = rs.Tracer(over_ground()), rs.Tracer(over_ground(low=0.0))
    seen = rs.visibility(whole, a, b)
    assert_same_bits(seen, rs.visibility(half, a, b))
    for form in ("bits", "sparse"):
        found, expected = (rs.visibility(one, a, b, form=form) for one in (whole, half))
        if form == "bits":
            assert_same_bits(found, expected)
        else:
            assert_same_bits(found.indices, expected.indices)


@pytest.mark.parametrize("placed", PLACED)
def test_triangles_that_are_skipped_and_cut_out_both_hide_nothing(placed) -> None:
    tracer = rs.Tracer(over_ground(placed=placed))
    ground = rs.Tracer(over_ground(placed=placed)).first_hit(
        ABOVE, DOWN, skip_prim_ids=[[0, 1]] * 2
    )
    assert rs.visibility(tracer, ABOVE, ground).diagonal().tolist() == [True, False]
    skipped = rs.visibility(tracer, ABOVE, ground.positions, skip_b=np.full((2, 2), [2, 3]))
    assert skipped.diagonal().tolist() == [True, False]
    skipped = rs.visibility(tracer, ABOVE, ground, skip_a=[[0, 1]] * 2)
    assert skipped.all()


@pytest.mark.parametrize("name", ["seen.npy", pytest.param("seen.zarr", marks=pytest.mark.ci)])
def test_files_of_other_cut_outs_are_not_resumed(tmp_path, name) -> None:
    if name.endswith("zarr"):
        pytest.importorskip("zarr")
    path = tmp_path / name
    seen = rs.visibility(rs.Tracer(over_ground()), ABOVE, BELOW, out=path)
    assert np.asarray(seen).tolist() == [[True, False], [True, False]]
    again = rs.visibility(rs.Tracer(over_ground()), ABOVE, BELOW, out=path)
    assert_same_bits(np.asarray(again), np.asarray(seen))
    mirrored = cut_out().textures["opacity"].changed(_mirrored)
    other = rs.Material(textures={"opacity": mirrored}, alpha_cutoff=0.5)
    scene = over_ground().replace(materials=[other, rs.Material()])
    assert rs.visibility(rs.Tracer(scene), ABOVE, BELOW).tolist() == [[False, True], [False, True]]
    for tracer, options in ((rs.Tracer(scene), {}), (rs.Tracer(over_ground()), {"cutouts": False})):
        with pytest.raises(rs.FileFormatError):
            rs.visibility(tracer, ABOVE, BELOW, out=path, **options)


def _mirrored(pixels):
    return np.ascontiguousarray(pixels[:, ::-1])


def test_tracers_that_cannot_filter_say_so() -> None:
    counting = rs.Tracer(over_ground(), counters=True)
    for ask in (rs.visible_faces, rs.view_factors, lambda one: rs.visibility(one, ABOVE)):
        with pytest.raises(ValueError, match="cutouts=True: a tracer with counters=True"):
            ask(counting)


# View factors


def room(kind: str = "mask", low: float = -1.0) -> rs.Scene:
    """A card that faces a floor at distance 1, and a floor that faces it."""
    leaf = card(0.0, 0, low=low)
    down = rs.Mesh(leaf.vertices, leaf.faces[:, ::-1], texcoords=leaf.texcoords, material_ids=0)
    meshes = [card(-1.0, 1, 1.5), faded(down, kind)]
    return rs.Scene(meshes, materials=[cut_out(kind), rs.Material()])


@pytest.mark.parametrize("kind", KINDS)
def test_factors_of_a_card_are_those_of_its_half(kind) -> None:
    found = rs.view_factors(room(kind), rays=1 << 15)
    half = rs.view_factors(room(low=0.0), rays=1 << 15, seed=1)
    error = 4.0 * np.hypot(found.standard_errors, half.standard_errors)
    assert (np.abs(found.factors - half.factors) <= error).all()
    assert found.areas == pytest.approx([9.0, 2.0], rel=0.01)
    assert found.ray_counts[1] == pytest.approx(1 << 14, rel=0.01)
    np.testing.assert_allclose(found.factors.sum(axis=1) + found.outside + found.other, 1.0)
    exchange = found.areas[:, None] * found.factors
    assert exchange[0, 1] == pytest.approx(exchange[1, 0], rel=0.03)
    solid = rs.view_factors(room(kind), rays=1 << 15, cutouts=False)
    assert solid.factors[0, 1] > 1.5 * found.factors[0, 1]
    assert solid.areas.tolist() == [9.0, 4.0]


def test_errors_of_a_card_are_true() -> None:
    """Over many seeds, factors differ by what their standard errors say."""
    runs = [rs.view_factors(room(), rays=256, seed=seed) for seed in range(40)]
    factors, errors = (
        np.array([getattr(one, name)[1, 0] for one in runs])
        for name in ("factors", "standard_errors")
    )
    assert 0.6 < factors.std() / np.sqrt((errors**2).mean()) < 1.5


def test_what_is_hidden_behind_a_hole() -> None:
    """A floor sees a ceiling through the hole of a card just below it."""
    ceiling = rs.Mesh(card(0.01).vertices, card().faces[:, ::-1], material_ids=1)
    scene = rs.Scene([*room().meshes, ceiling], materials=room().materials)
    found = rs.view_factors(scene, rays=1 << 14)
    alone = rs.view_factors(rs.Scene([room().meshes[0], ceiling], materials=room().materials))
    assert found.factors[0, 1] + found.factors[0, 2] == pytest.approx(alone.factors[0, 1], abs=0.01)
    assert found.factors[0, 2] == pytest.approx(0.5 * alone.factors[0, 1], abs=0.01)


def test_a_patch_that_is_cut_out_everywhere_is_refused() -> None:
    gone = rs.Material(opacity=0.1)
    scene = room().replace(materials=[gone, rs.Material()])
    with pytest.raises(ValueError, match=r"patch 1 is cut out at all .* cutouts=False"):
        rs.view_factors(scene)
    found = rs.view_factors(scene, [0, 0, -1, -1])
    assert found.outside.tolist() == [1.0]
    with pytest.raises(TypeError, match="cutout"):
        rs.view_factors(scene, cutout=False)


# Visible faces


def strips(kind: str = "mask", placed: bool = False) -> rs.Scene:
    """A card in four columns, two of which are cut out, over ground."""
    xs = np.linspace(-1.0, 1.0, 5)
    corners = np.array([[x, y] for y in (-1.0, 1.0) for x in xs])
    faces = [f for k in range(4) for f in ([k, k + 1, k + 6], [k, k + 6, k + 5])]
    leaf = rs.Mesh(np.column_stack([corners, np.zeros(10)]), faces, texcoords=(corners + 1.0) / 2.0)
    leaf, ground = faded(leaf, kind), card(-1.0, 1, 9.0)
    materials = [cut_out(kind), rs.Material()]
    if placed:
        return rs.Scene.instances([leaf, ground], [np.eye(3, 4)] * 2, [0, 1], materials=materials)
    return rs.Scene([leaf, ground], materials=materials)


@pytest.mark.parametrize("placed", PLACED)
@pytest.mark.parametrize("kind", KINDS)
def test_holes_are_not_seen_and_hide_nothing(kind, placed) -> None:
    camera = rs.Camera((0.1, 0.2, 3.0), (0.1, 0.2, 0.0), fov=60, up=(0, 1, 0))
    tracer = rs.Tracer(strips(kind, placed))
    seen = rs.visible_faces(tracer, camera, (64, 48))
    assert seen.prim_ids.tolist() == [4, 5, 6, 7, 8, 9]
    solid = rs.visible_faces(tracer, camera, (64, 48), cutouts=False)
    assert solid.prim_ids.tolist() == list(range(10))
    assert seen.pixel_counts[:4].tolist() == solid.pixel_counts[4:8].tolist()
    assert seen.pixel_counts.sum() == solid.pixel_counts.sum()


@pytest.mark.parametrize("placed", PLACED)
def test_additional_rays_find_small_faces_through_holes_and_none_in_holes(placed) -> None:
    """One pixel shows the ground: the rest is found by points of faces."""
    camera = rs.Camera((0.0, 0.2, 3.0), (2.5, 0.2, 0.0), fov=120, up=(0, 1, 0))
    seen = rs.visible_faces(rs.Tracer(strips(placed=placed)), camera, (1, 1))
    assert {4, 5, 6, 7} <= set(seen.prim_ids.tolist())
    assert not {0, 1, 2, 3} & set(seen.prim_ids.tolist())
    # Below the card: a small face on the ground, seen through the hole only.
    small = card(-0.5, 1, 0.01).moved(card(-0.5, 1, 0.01).vertices + [-0.5, 0.0, 0.0])
    scene = rs.Scene([*strips().meshes, small], materials=strips().materials)
    above = rs.Camera((-0.4, 0.1, 3.0), (-0.4, 0.1, 0.0), fov=60, up=(0, 1, 0))
    for cutouts in (True, False):
        ids = rs.visible_faces(rs.Tracer(scene), above, (5, 5), cutouts=cutouts).prim_ids
        assert ({10, 11} <= set(ids.tolist())) == cutouts
