"""The engine of an example: closed solids inside each other that fit, of the requested count."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

import raystream as rs
from engine import crank_drive, make_engine
from engine.assembly import fitted
from engine.model import MIN_TRIANGLES, SMOOTH_TRIANGLES, all_pieces
from engine.mounts import FLOOR
from engine.valve_train import cam_angles, lifts
from scene.procedural.closed import open_edges, volume

ONE_SIZE = 60_000


@pytest.fixture(scope="module")
def tracer():
    return rs.Tracer(make_engine(ONE_SIZE))


def mesh_of(scene, name):
    return next(mesh for mesh in scene.meshes if mesh.name == name)


@pytest.mark.parametrize("target", [24, 36, 99, 500, 5000, 12_000, 20_000, 35_000, 150_000])
def test_every_mesh_is_a_solid(target):
    scene = make_engine(target)
    assert scene.skipped_count == 0
    for mesh in scene.meshes:
        assert open_edges(mesh.faces) == 0, mesh
        assert volume(mesh.vertices, mesh.faces) > 0.0, mesh
        assert (mesh.normals is not None) == (target >= SMOOTH_TRIANGLES)


def test_counts_are_close_to_all_targets():
    targets = [*range(MIN_TRIANGLES, 132), *(round(131 * 2.6**k) for k in range(16))]
    targets += [SMOOTH_TRIANGLES - 1, SMOOTH_TRIANGLES]
    for target in targets:
        count = sum(piece.triangles for piece in fitted(all_pieces, target, SMOOTH_TRIANGLES))
        most = 11 if target < 10_000 else 0.01 * target
        assert 0 <= target - count <= most, (target, count)


@pytest.mark.parametrize("target", [24, 1000, 34_999, 35_000, 200_000])
def test_counts_are_known_before_pieces_are_made(target):
    count = sum(piece.triangles for piece in fitted(all_pieces, target, SMOOTH_TRIANGLES))
    assert make_engine(target).triangle_count == count


@pytest.mark.filterwarnings("ignore:thickness. meshes overlap")
@pytest.mark.parametrize("target", [2000, 12_000, 36_000, ONE_SIZE])
def test_solids_hardly_overlap(target):
    found = shotlines(rs.Tracer(make_engine(target)), 20_000)
    assert found.mesh_is_closed.all()
    assert not found.mesh_is_flipped.any()
    assert found.is_complete.all()
    both = sum(overlaps(found).values())
    assert both < 0.003 * found.path_length.sum()


def shotlines(tracer, count):
    rng = np.random.default_rng(3)
    targets = rng.uniform((-0.3, 0.03, -0.24), (0.3, 0.6, 0.22), (count, 3))
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    return rs.thickness(tracer, targets - 2.0 * directions, directions)


def overlaps(found):
    """Lengths that two meshes share, by their names."""
    shared = Counter()
    for ray in range(len(found.ray_splits) - 1):
        rows = slice(found.ray_splits[ray], found.ray_splits[ray + 1])
        entry, leave, mesh = found.t_entry[rows], found.t_exit[rows], found.mesh_id[rows]
        length = np.minimum(leave[:, None], leave) - np.maximum(entry[:, None], entry)
        for first, second in np.argwhere(np.triu(length, 1) > 1e-5):
            names = found.mesh_names[mesh[first]], found.mesh_names[mesh[second]]
            shared[names] += length[first, second]
    return shared


@pytest.mark.filterwarnings("ignore:thickness. meshes overlap")
def test_a_line_along_a_cylinder_meets_its_parts_from_the_cover_to_the_table(tracer):
    lift = -FLOOR
    x = crank_drive.CYLINDERS[1] - 0.02  # through the intake valve's stem
    found = rs.thickness(tracer, [x, 0.8, -0.0081], [0.0, -1.0, 0.0])
    names = [found.mesh_names[mesh] for mesh in found.mesh_id]
    parts = ["cover", "camshaft", "intake tappet 2", "intake valve 2", "piston 2", "crankshaft"]
    places = [names.index(part) for part in [*parts, "pan", "table"]]
    assert places == sorted(places)
    top = 0.8 - found.t_entry[names.index("piston 2")]
    height = lift + crank_drive.pin_heights()[1] + crank_drive.CROWN
    assert top == pytest.approx(height, abs=0.002)


def test_a_line_across_a_liner_passes_two_walls(tracer):
    x, y = crank_drive.CYLINDERS[0], 0.29  # below its piston
    found = rs.thickness(tracer, [x, y, -1.0], [0.0, 0.0, 1.0])
    (liner,) = [i for i, name in enumerate(found.mesh_names) if name == "liner 1"]
    assert found.total_length(by="mesh")[liner] == pytest.approx(0.007, rel=0.05)
    assert (found.mesh_id == liner).sum() == 2


def test_an_x_ray_across_a_journal_shows_its_chords():
    scene = make_engine(400_000)
    crankshaft = rs.Scene(
        [mesh_of(scene, "crankshaft")], materials=scene.materials, background=(0.0, 0.0, 0.0)
    )
    offset = np.linspace(-0.02, 0.02, 9)
    x, axis = crank_drive.MAINS[2], -FLOOR
    origins = np.stack([np.full(9, x), axis + offset, np.full(9, -1.0)], axis=1)
    found = rs.thickness(rs.Tracer(crankshaft), origins, [0.0, 0.0, 1.0])
    chords = 2.0 * np.sqrt(0.027**2 - offset**2)
    np.testing.assert_allclose(found.total_length(), chords, rtol=3e-3)
    # As an image: the line of sight through each pixel's centre.
    camera = rs.Camera((x, axis, -1.0), (x, axis, 0.0), projection="orthographic", height=0.05)
    image = rs.render(crankshaft, "xray", size=(1, 25), camera=camera, absorption=30.0)
    offset = (np.arange(25) + 0.5) / 25 * 0.05 - 0.025
    passed = np.exp(-30.0 * 2.0 * np.sqrt(0.027**2 - offset**2))
    np.testing.assert_allclose(image.pixels[:, 0, 0], passed, rtol=5e-3)


def test_rods_connect_cranks_and_pistons():
    scene = make_engine(ONE_SIZE)
    heights = crank_drive.pin_heights()
    assert heights[0] == pytest.approx(heights[3])
    assert heights[0] - heights[1] > 0.06
    for cylinder in range(4):
        rod, pin = (mesh_of(scene, f"{name} {cylinder + 1}").vertices for name in ("rod", "pin"))
        middle = (pin.min(axis=0) + pin.max(axis=0)) / 2 + [0.0, FLOOR, 0.0]
        np.testing.assert_allclose(
            middle, [crank_drive.CYLINDERS[cylinder], heights[cylinder], 0.0], atol=1e-3
        )
        assert rod[:, 1].max() == pytest.approx(-FLOOR + heights[cylinder] + 0.0155, abs=1e-3)


def test_valves_open_in_the_firing_order():
    # 30 degrees after the first cylinder fires: 3 takes air in, 2 exhausts, 1 is closed.
    np.testing.assert_allclose(cam_angles("intake"), [-219.0, -129.0, 51.0, -39.0])
    intake, exhaust = lifts("intake"), lifts("exhaust")
    np.testing.assert_allclose(intake[[0, 1]], 0.0, atol=1e-9)
    np.testing.assert_allclose(exhaust[[0, 2]], 0.0, atol=1e-9)
    assert exhaust[1] > 0.006
    assert 0.0 < intake[2] < 0.006
    assert max(intake.max(), exhaust.max()) <= 0.0095 + 1e-9


def test_oil_lies_in_the_hollow_pan(tracer):
    found = rs.thickness(tracer, [0.1, -0.1, 0.02], [0.0, 1.0, 0.0])
    names = [found.mesh_names[mesh] for mesh in found.mesh_id]
    pan, oil = names.index("pan"), names.index("oil")
    assert pan < oil
    assert found.path_length[pan] == pytest.approx(0.002, abs=1e-5)
    assert found.path_length[oil] == pytest.approx(0.0372, abs=1e-5)


def test_too_few_triangles_are_refused():
    with pytest.raises(ValueError, match="at least 24, got 23"):
        make_engine(23)
