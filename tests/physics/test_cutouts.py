"""Cut-outs in LiDAR and thickness, against cards that have only the half that is there."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from cards import DOWN, KINDS, card, cut_out, over_ground
from conftest import assert_same_bits, skip_without_adapter
from meshes import cube
from raystream.programs.cutouts import cutouts_of

#: Over the half that is cut out, the half that is there, and beside the card.
ORIGINS = [[-0.5, 0.3, 5.0], [0.5, 0.3, 5.0], [3.0, 0.3, 5.0]]

#: The others need kernels of their own.
PLACED = [False, pytest.param(True, marks=pytest.mark.ci)]


@pytest.mark.parametrize("placed", PLACED)
@pytest.mark.parametrize("kind", KINDS)
def test_pulses_pass_through_holes(kind, placed) -> None:
    tracer = rs.Tracer(over_ground(kind, placed))
    found = rs.lidar_returns(tracer, ORIGINS, DOWN)
    assert found.ranges.tolist() == [6.0, 5.0, 6.0]
    assert found.material_id.tolist() == [1, 0, 1]
    assert found.instance_id.tolist() == ([1, 0, 1] if placed else [0, 0, 0])
    solid = rs.lidar_returns(tracer, ORIGINS, DOWN, cutouts=False)
    assert solid.ranges.tolist() == [5.0, 5.0, 6.0]


@pytest.mark.ci
@pytest.mark.parametrize("structure", ["brute", "kdtree", "grid", "graph"])
@pytest.mark.parametrize("machine", ["branching", "multipass"])
def test_every_structure_and_machine_has_the_same_returns(structure, machine, rng) -> None:
    scene = over_ground()
    origins = np.column_stack([rng.uniform(-2, 2, (500, 2)), np.full(500, 5.0)])
    directions = np.array(DOWN) + rng.normal(0.0, 0.05, (500, 3))
    if (structure, machine) == ("graph", "multipass"):
        pytest.skip("graphs have no passes")
    found, expected = (
        rs.lidar_returns(tracer, origins, directions, transmission=0.5)
        for tracer in (rs.Tracer(scene, structure, machine=machine), rs.Tracer(scene))
    )
    for name in ("ray_splits", "ranges", "intensity", "prim_id"):
        assert_same_bits(getattr(found, name), getattr(expected, name))


@pytest.mark.ci
@pytest.mark.parametrize("placed", [False, True])
def test_graphics_devices_pass_through_holes(placed) -> None:
    skip_without_adapter()
    tracer = rs.Tracer(over_ground(placed=placed), device="graphics")
    assert rs.lidar_returns(tracer, ORIGINS, DOWN).ranges.tolist() == [6.0, 5.0, 6.0]
    assert rs.thickness(tracer, ORIGINS, DOWN).unpaired_mesh_id.tolist() == [1, 0, 1, 1]
    below = np.array(ORIGINS) * [1, 1, 0] - [0, 0, 0.5]
    seen = rs.visibility(tracer, ORIGINS, below).diagonal()
    assert seen.tolist() == [True, False, True]


@pytest.mark.parametrize("kind", KINDS)
def test_spheres_and_height_fields_are_there_by_their_opacity(kind) -> None:
    """Over the half of the card that is there: one of each that is, and one that is not."""
    clear, solid = (rs.Material(opacity=opacity) for opacity in (0.3, 0.7))
    above = [[0.5, 0.3, 3.0]], [[3.0, 0.3, 3.0]]
    balls = [rs.Scene.spheres(*one) for one in zip(above, (0.5, 0.5), strict=True)]
    fields = [
        rs.Scene.height_field(np.zeros((2, 2)), origin=(x, 0.2, 4.0), spacing=0.2)
        for x in (0.4, -0.6)
    ]
    materials = [solid, clear, clear, solid]
    parts = [one.replace(materials=[m]) for one, m in zip(balls + fields, materials, strict=True)]
    scene = rs.Scene.combine([over_ground(kind), *parts])
    found = rs.lidar_returns(rs.Tracer(scene), ORIGINS, DOWN)
    assert found.ranges.tolist() == [1.0, 1.5, 6.0]
    assert found.material_id.tolist() == [5, 2, 1]
    through = rs.lidar_returns(rs.Tracer(scene), ORIGINS, DOWN, transmission=0.5)
    assert through.ranges.tolist() == [1.0, 6.0, 1.5, 2.5, 5.0, 6.0, 6.0]


def test_sub_rays_share_the_energy_between_a_card_and_what_its_hole_shows() -> None:
    cone = {"divergence": 5.0, "sub_rays": 400, "separation": 0.1}
    found = rs.lidar_returns(rs.Tracer(over_ground()), [0.0, 0.0, 5.0], DOWN, **cone)
    assert found.ranges == pytest.approx([5.0, 6.0], abs=0.01)
    assert found.intensity == pytest.approx([0.5, 0.5], abs=0.01)


def test_transmission_applies_to_what_is_there() -> None:
    found = rs.lidar_returns(
        rs.Tracer(over_ground()), ORIGINS, DOWN, transmission={"leaf": 0.25}, reflectance=0.5
    )
    assert found.ray_splits.tolist() == [0, 1, 3, 4]
    assert found.intensity == pytest.approx([0.5, 0.375, 0.125, 0.5])


def test_sweeps_pass_through_holes_that_move() -> None:
    """The card moves by 1 to the right, so that the sensor's ray first meets it, then its hole."""
    straight = rs.sweep_patterns.SweepPattern([[0, 0, -1]] * 2, [0.0, 1.0], period=1.0)
    still = rs.SensorTrack([0.0, 1.0], [[0.5, 0.3, 5.0]] * 2)
    scene = over_ground()
    assert rs.lidar_sweep(rs.Tracer(scene), straight, still).ranges.tolist() == [5.0, 5.0]

    def move(time):
        leaf, ground = scene.meshes
        shift = [1.0 if time > 0.5 else 0.0, 0.0, 0.0]
        return scene.replace(meshes=[leaf.moved(leaf.vertices + shift), ground])

    moving = scene.replace(animation=rs.Animation(move, (0.0, 1.0)))
    for cutouts, last in ((True, 6.0), (False, 5.0)):
        swept = rs.lidar_sweep(rs.Tracer(moving), straight, still, time_steps=2, cutouts=cutouts)
        assert swept.ranges.tolist() == [5.0, last]


def box(material: int = 0, **attributes) -> rs.Mesh:
    """A closed cube from -1 to 1, whose faces would be cut out where x is negative."""
    vertices, faces = cube()
    vertices = 2.0 * vertices - 1.0
    texcoords = np.clip((vertices[:, :2] + 1.0) / 2.0, 0.0, 1.0)
    return rs.Mesh(vertices, faces, material_ids=material, texcoords=texcoords, **attributes)


@pytest.mark.parametrize("placed", PLACED)
@pytest.mark.parametrize("kind", KINDS)
def test_thickness_meets_no_card_where_it_is_cut_out(kind, placed) -> None:
    """Open meshes have crossings without a partner, and none in a hole."""
    found = rs.thickness(rs.Tracer(over_ground(kind, placed)), ORIGINS, DOWN)
    assert found.unpaired_ray.tolist() == [0, 1, 1, 2]
    assert found.unpaired_mesh_id.tolist() == [1, 0, 1, 1]
    solid = rs.thickness(rs.Tracer(over_ground(kind, placed)), ORIGINS, DOWN, cutouts=False)
    assert solid.unpaired_ray.tolist() == [0, 0, 1, 1, 2]


@pytest.mark.parametrize("placed", PLACED)
def test_thickness_takes_closed_meshes_as_solids(placed, rng) -> None:
    meshes = [box(), card(2.0), card(-2.0)]
    materials = [cut_out()]
    scene = rs.Scene(meshes, materials=materials)
    if placed:
        scene = rs.Scene.instances([meshes], np.eye(3, 4), [0], materials=materials)
    tracer = rs.Tracer(scene)
    found = rs.thickness(tracer, ORIGINS, DOWN)
    assert found.path_length.tolist() == [2.0, 2.0]
    assert found.is_complete.tolist() == [True, False, True]
    assert found.unpaired_mesh_id.tolist() == [1, 2]
    solid = rs.thickness(tracer, ORIGINS, DOWN, cutouts=False)
    assert solid.is_complete.tolist() == [False, False, True]
    assert_same_bits(solid.t_exit, found.t_exit)
    # Without open meshes there is nothing to filter.
    alone = rs.Tracer(rs.Scene([box()], materials=materials))
    assert cutouts_of(alone, True, np.array([True])) is None


def test_a_file_with_a_map_of_opacity(tmp_path) -> None:
    from PIL import Image

    Image.fromarray(np.array([[0, 255]], np.uint8)).save(tmp_path / "leaf.png")
    (tmp_path / "card.mtl").write_text("newmtl leaf\nmap_d -clamp on leaf.png\n")
    (tmp_path / "card.obj").write_text(
        "mtllib card.mtl\nv -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
        "usemtl leaf\nf 1/1 2/2 3/3 4/4\n"
    )
    tracer = rs.Tracer(rs.load(tmp_path / "card.obj"))
    assert rs.lidar_returns(tracer, ORIGINS, DOWN).ray_id.tolist() == [1]
    assert rs.lidar_returns(tracer, ORIGINS, DOWN, cutouts=False).ray_id.tolist() == [0, 1]


@pytest.mark.parametrize(
    ("opacity", "cutoff", "ray_count"),
    [(0.49, None, 1), (0.5, None, 2), (0.3, 0.2, 2), (0.3, 0.4, 1)],
)
def test_constant_opacity(opacity, cutoff, ray_count) -> None:
    material = rs.Material(opacity=opacity, alpha_cutoff=cutoff)
    scene = rs.Scene([card(), card(-1.0, 1)], materials=[material, rs.Material()])
    found = rs.lidar_returns(rs.Tracer(scene), ORIGINS, DOWN)
    assert found.ranges.tolist() == ([6.0, 6.0] if ray_count == 1 else [5.0, 5.0])


@pytest.mark.parametrize(
    "materials",
    [
        [rs.Material()],
        [rs.Material(), rs.Material(opacity=0.1)],  # not used
        [rs.Material(opacity=0.7, alpha_cutoff=0.5)],
        [rs.Material(textures={"opacity": rs.Texture(np.full((2, 2, 1), 255, np.uint8))})],
    ],
)
def test_opaque_scenes_have_no_filter(materials, monkeypatch) -> None:
    tracer = rs.Tracer(rs.Scene([card()], materials=materials))
    filters = []
    trace = tracer.multi_hit
    monkeypatch.setattr(
        tracer,
        "multi_hit",
        lambda *rays, on_hit=None, **more: filters.append(on_hit) or trace(*rays, **more),
    )
    rs.lidar_returns(tracer, ORIGINS, DOWN)
    rs.thickness(tracer, ORIGINS, DOWN)
    assert filters
    assert set(filters) == {None}


def test_what_cannot_filter_says_so() -> None:
    counting = rs.Tracer(over_ground(), counters=True)
    with pytest.raises(ValueError, match=r"cutouts=True: a tracer with counters.* cutouts=False"):
        rs.lidar_returns(counting, ORIGINS, DOWN)
    assert len(rs.lidar_returns(counting, ORIGINS, DOWN, cutouts=False).ranges) == 3
