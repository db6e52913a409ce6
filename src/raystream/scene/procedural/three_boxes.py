"""Three boxes: two on a flat one, all of them mirrors."""

from __future__ import annotations

from raystream.scene.camera import Camera
from raystream.scene.lights import PointLight
from raystream.scene.material import Material
from raystream.scene.procedural.parts import instance, to_mesh, yaw
from raystream.scene.procedural.shapes import box
from raystream.scene.procedural.size import check_triangles, closest_divisions
from raystream.scene.scene import Scene

DEFAULT_TRIANGLES = 36

#: Reflectance of the flat box, and of the boxes on it.
BASE_SHARE, BOX_SHARE = 0.3, 0.6

MATERIALS = (
    Material("base", diffuse=(0.36, 0.35, 0.33), reflection=(BASE_SHARE,) * 3),
    Material("red", diffuse=(0.4, 0.05, 0.04), reflection=(BOX_SHARE,) * 3),
    Material("blue", diffuse=(0.05, 0.12, 0.4), reflection=(BOX_SHARE,) * 3),
)

#: Centre and half size, metres. Between the upper two is a gap, in which rays go back and forth.
BOXES = (
    ("base", (0.0, -0.25, 0.0), (2.8, 0.25, 2.3)),
    ("tall box", (-0.85, 1.1, -0.1), (0.7, 1.1, 0.8)),
    ("low box", (0.85, 0.7, -0.1), (0.75, 0.7, 0.8)),
)


def three_boxes(triangles: int = DEFAULT_TRIANGLES) -> Scene:
    """Make two boxes on a flat one, for the scene A of Christen 2005.

    The thesis describes it as "3 boxes" of 36 triangles; their arrangement and materials are
    ours. The flat box mirrors 0.3 of the light, the others 0.6: they reflect each other.

    Parameters
    ----------
    triangles : int
        Target count: 36 without subdivision, else every face is divided evenly. The actual
        count comes as close as that of `cornell`.

    Returns
    -------
    Scene
        In metres, y up, one mesh per box; two point lights before a blue background.

    Raises
    ------
    ValueError
        If the target is out of range.

    References
    ----------
    Christen 2005, section 6.2.1, scene A.
    """
    across, along = closest_divisions(
        check_triangles(triangles), lambda a, b: 12 * (2 * a * b + a * a)
    )
    part = box((across, along, across))
    meshes = [
        to_mesh(instance(part, yaw([0.0], [half]), [centre], material_ids=[number]), name)
        for number, (name, centre, half) in enumerate(BOXES)
    ]
    return Scene(
        meshes,
        materials=MATERIALS,
        lights=(
            PointLight((2.5, 5.0, 5.0), (100.0, 95.0, 86.0)),
            PointLight((-4.5, 4.0, 3.0), (34.0, 37.0, 42.0)),
        ),
        camera=Camera((2.9, 3.7, 6.2), (0.0, 0.6, 0.0), fov=40.0),
        background=(0.1, 0.14, 0.2),
        name="three_boxes",
    )
