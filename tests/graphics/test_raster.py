"""Rasterised visibility beside primary rays, and shadows on it."""

import numpy as np
import pytest

import raystream as rs
from dark_views import DARK_VIEWS
from graphics.edges import edge_distance

pytestmark = pytest.mark.usefixtures("opened")

SIZE = 48, 40

#: Pixels: rasterisers move corners to a lattice of 1/256, and half of that is diagonal.
LATTICE = 1.0 / 256.0


def seen_both_ways(scene, size=SIZE):
    from raystream.graphics import visibility

    camera = scene.camera_for(size[0] / size[1])
    hits = rs.Tracer(scene).first_hit(*camera.rays(*size))
    return camera, visibility(scene, size, camera=camera), hits


def check_same(scene, size=SIZE):
    """The image that primary rays see, except for pixels with centres on edges; returns these."""
    camera, seen, hits = seen_both_ways(scene, size)
    assert seen.prim_id.shape == hits.prim_id.shape == size[::-1]
    same = seen.prim_id == hits.prim_id
    rows, columns = np.nonzero(~same)
    distance = np.minimum(
        edge_distance(scene, camera, size, seen.prim_id[~same], rows, columns),
        edge_distance(scene, camera, size, hits.prim_id[~same], rows, columns),
    )
    assert (distance <= LATTICE).all()
    for name, allowed in (("t", 0.0), ("u", 1e-6), ("v", 1e-6)):
        ours, theirs = getattr(seen, name)[same], getattr(hits, name)[same]
        np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=allowed, err_msg=name)
    assert hits.is_hit.any()
    return ~same


@pytest.mark.parametrize("name", ["cornell", "spheres"])
def test_what_is_rasterised_is_what_primary_rays_see(name):
    assert np.count_nonzero(check_same(rs.load(name))) < 4


def test_the_bunny_is_seen_alike(scenes_folder):
    size = 128, 128
    differing = check_same(rs.load(scenes_folder / "bunny" / "bun_zipper.ply"), size)
    assert np.count_nonzero(differing) < 0.005 * differing.size


def wall(*, z, half=1.0):
    """A square of two triangles across the view."""
    corners = [[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]]
    return rs.Mesh(np.array(corners), np.array([[0, 1, 2], [0, 2, 3]]))


def test_surfaces_through_and_behind_the_eye_are_clipped():
    """A floor that extends behind the eye, a wall behind it, and a wall ahead."""
    floor = rs.Mesh([[-50, -1, -50], [50, -1, -50], [0, -1, 90]], [[0, 1, 2]])
    camera = rs.Camera((0, 0, 0), (0, 0, -1), fov=90.0)
    scene = rs.Scene([floor, wall(z=3.0), wall(z=-2.0)], camera=camera)
    _, seen, hits = seen_both_ways(scene)
    np.testing.assert_array_equal(np.unique(seen.prim_id), [-1, 0, 3, 4])
    is_edge = seen.prim_id != hits.prim_id
    assert np.count_nonzero(is_edge) <= 2
    # The floor is at -y / t = -1 in every direction.
    _, directions = camera.rays(*SIZE)
    on_floor = seen.prim_id == 0
    np.testing.assert_allclose(seen.t[on_floor] * directions[on_floor][:, 1], -1.0, rtol=1e-5)


@pytest.mark.parametrize("z", [-1e-3, -1.0, -1e3, -1e6])
def test_depth_tells_near_from_far_at_any_distance(z):
    """Two walls whose distances differ by a millionth, the far one drawn last."""
    half = abs(z)
    scene = rs.Scene([wall(z=z, half=half), wall(z=z * (1.0 + 1e-6), half=half)])
    far_first = rs.Scene(scene.meshes[::-1])
    camera = rs.Camera((0, 0, 0), (0, 0, -1), fov=40.0)
    from raystream.graphics import visibility

    for one, expected in ((scene, {0, 1}), (far_first, {2, 3})):
        seen = visibility(one, (9, 8), camera=camera)
        assert set(seen.prim_id.ravel().tolist()) == expected
        np.testing.assert_allclose(seen.t.min(), half, rtol=0.01)


def test_nothing_is_seen_of_an_empty_scene():
    from raystream.graphics import visibility

    seen = visibility(rs.Scene(), (5, 3))
    assert (seen.prim_id == -1).all()
    assert np.isinf(seen.t).all()
    assert not seen.u.any()
    assert not seen.v.any()


def test_degenerate_and_broken_triangles_are_not_drawn():
    good = wall(z=-2.0)
    bad = rs.Mesh([[-1, -1, -1], [1, 1, -1], [0, 0, -1], [np.nan, 0, -1]], [[0, 1, 2], [0, 1, 3]])
    scene = rs.Scene([bad, good], camera=rs.Camera((0, 0, 0), (0, 0, -1)))
    _, seen, _ = seen_both_ways(scene)
    assert set(np.unique(seen.prim_id)) == {2, 3}


def test_cameras_that_do_not_project_so_are_refused():
    from raystream.graphics import visibility

    camera = rs.Camera((0, 0, 0), (0, 0, -1), projection="orthographic")
    with pytest.raises(ValueError, match="camera: the graphics pipeline supports only"):
        visibility(rs.Scene([wall(z=-2.0)]), SIZE, camera=camera)


@pytest.mark.filterwarnings("ignore:the scene's own lights")
@pytest.mark.parametrize("name", ["cornell", "spheres", *DARK_VIEWS])
def test_shadows_on_what_was_rasterised_are_those_of_mode_shadow(name):
    from raystream.graphics import hybrid

    scene = DARK_VIEWS[name]() if name in DARK_VIEWS else rs.load(name)
    camera = scene.camera_for(SIZE[0] / SIZE[1])
    tracer = rs.Tracer(scene)
    image = hybrid(tracer, SIZE, camera=camera)
    expected = rs.render(tracer, "shadow", SIZE, camera=camera)
    same = image.layers["prim_id"] == tracer.first_hit(*camera.rays(*SIZE)).prim_id
    np.testing.assert_allclose(image.pixels[same], expected.pixels[same], rtol=1e-4, atol=1e-5)
    assert np.count_nonzero(~same) < 4


def test_shadow_rays_are_traced_on_the_graphics_device_unless_told_otherwise():
    from raystream.graphics import hybrid

    floor = rs.Mesh([[-4, 0, -4], [4, 0, -4], [4, 0, 4], [-4, 0, 4]], [[0, 2, 1], [0, 3, 2]])
    lid = rs.Mesh([[-1, 1, -1], [1, 1, -1], [1, 1, 1], [-1, 1, 1]], [[0, 2, 1], [0, 3, 2]])
    scene = rs.Scene(
        [floor, lid],
        lights=[rs.DirectionalLight((0.0, -1.0, 0.0), (np.pi, np.pi, np.pi))],
        camera=rs.Camera((0, 9, 3), (0, 0, 0)),
    )
    image = hybrid(scene, (32, 32), "brute")
    # A white sun straight above grey ground: it shows its 0.8, or nothing below the lid.
    values = np.unique(np.round(image.pixels[image.layers["prim_id"] >= 0], 4))
    np.testing.assert_allclose(values, [0.0, 0.8], atol=1e-4)


def test_what_is_not_opaque_is_refused():
    from raystream.graphics import hybrid

    glassy = rs.Scene([wall(z=-2.0)], materials=[rs.Material(opacity=0.5)])
    with pytest.raises(ValueError, match="not opaque"):
        hybrid(glassy, (8, 8), "brute")


@pytest.mark.exhaustive
def test_all_modes_give_the_same_pictures_from_several_threads():
    """Bands are traced on several threads, which share a machine's buffers."""
    scene = rs.load("cornell")
    size = 96, 96
    ours = rs.Tracer(scene, "brute", "graphics")
    theirs = rs.Tracer(scene)
    for mode in ("whitted", "xray"):
        expected = rs.render(theirs, mode, size).pixels
        image = rs.render(ours, mode, size).pixels
        differing = np.abs(image - expected).max(axis=-1) > 1e-4
        assert np.count_nonzero(differing) < 10, mode
