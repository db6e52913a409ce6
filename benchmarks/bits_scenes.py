"""Scenes and rays that `same_bits` asks about.

Coordinates are integers divided by powers of two, and rays are made by correctly rounded operations
alone, without sines or normal distributions: both have the same bits on all processors and with all
versions of NumPy. Only the built-in scenes and the public models are made by other means.
"""

import numpy as np

import raystream as rs

#: The corners of a unit cube, and its triangles, counter-clockwise from outside.
CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
SIDES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
FACES = np.array([half for a, b, c, d in SIDES for half in ((a, b, c), (a, c, d))])

MATERIALS = [
    rs.Material("steel", diffuse=(0.5, 0.5, 0.625), reflection=(0.25, 0.25, 0.25)),
    rs.Material("wood", diffuse=(0.5, 0.375, 0.25)),
    rs.Material("leaf", diffuse=(0.125, 0.5, 0.125)),
]

#: A view of the scenes made here, which all lie around the origin.
CAMERA = rs.Camera((60, 40, 90), (0, 0, 0), fov=45)

#: Where the far scenes lie.
FAR = 1e6


def boxes(rng, count, material_id, scale=1.0):
    """A closed mesh of boxes that overlap, touch and share planes."""
    low, size = rng.integers(-32, 33, (count, 1, 3)), rng.integers(1, 9, (count, 1, 3))
    vertices = scale * (low + size * CORNERS).reshape(-1, 3)
    faces = (FACES + 8 * np.arange(count)[:, None, None]).reshape(-1, 3)
    return rs.Mesh(vertices, faces, name=f"boxes {material_id}", material_ids=material_id)


def heights_of(rng, rows, columns):
    """Heights of a rough terrain, in quarters."""
    return rng.integers(-8, 9, (rows, columns)) / 4.0


def sheet(rng, side, level=0.0):
    """An open mesh: rough ground, side x side vertices."""
    x, z = (axis.reshape(-1) - side // 2 for axis in np.meshgrid(*[np.arange(side)] * 2))
    vertices = np.stack([x, heights_of(rng, side, side).reshape(-1) + level, z], axis=1)
    ids = np.arange(side * side).reshape(side, side)
    a, b, c, d = ids[:-1, :-1], ids[1:, :-1], ids[1:, 1:], ids[:-1, 1:]
    halves = [np.stack(half, -1).reshape(-1, 3) for half in ([a, b, c], [a, c, d])]
    faces = np.concatenate(halves)
    return rs.Mesh(vertices, faces, name="sheet", material_ids=2)


def solids():
    """Closed meshes: boxes, boxes that face inward, and small boxes."""
    rng = np.random.default_rng(1)
    meshes = [boxes(rng, 50, 0), boxes(rng, 30, 1), boxes(rng, 40, 2, scale=0.25)]
    inward = rs.Mesh(meshes[1].vertices, meshes[1].faces[:, ::-1], name="in", material_ids=1)
    return rs.Scene([meshes[0], inward, meshes[2]], materials=MATERIALS, camera=CAMERA)


def blocks(shift=0.0):
    """Solids, open ground, and triangles that coincide, have no area or are not finite."""
    rng = np.random.default_rng(2)
    strange = [[0, 20, 0], [8, 20, 0], [0, 20, 8], [4, 20, 0], [np.nan, 0, 0]]
    twice = rs.Mesh(strange, [[0, 1, 2], [0, 1, 2], [0, 3, 1], [0, 4, 1], [2, 0, 1]])
    scene = solids()
    meshes = [*scene.meshes, sheet(rng, 33), twice]
    moved = [mesh.moved(mesh.vertices + shift) for mesh in meshes]
    return scene.replace(meshes=moved)


def placements(rng, count):
    """Transforms that mirror, shear and scale each axis differently; some are equal."""
    axes = rng.permuted(np.tile(np.arange(3), (count, 1)), axis=1)
    linear = np.eye(3)[axes] * rng.choice([-1.0, 1.0], (count, 1, 3))
    linear += rng.integers(-1, 2, (count, 3, 3)) / 8.0 * rng.integers(0, 2, (count, 1, 1))
    linear *= np.ldexp(1.0, rng.integers(-2, 2, (count, 1, 3)))
    shifts = rng.integers(-32, 33, (count, 3, 1)).astype(float)
    transforms = np.concatenate([linear, shifts], axis=2)
    transforms[1::8] = transforms[::8]
    return transforms


def instances(*, has_worlds=False, seed=3):
    """Meshes, objects of two meshes, and instances of instances, anywhere or in two worlds."""
    rng = np.random.default_rng(seed)
    small = boxes(rng, 4, 0, scale=0.125)
    nested = rs.Scene.instances(small, placements(rng, 4) * [0.125, 0.125, 0.125, 0.25])
    pair = [boxes(rng, 3, 1, scale=0.125), sheet(rng, 7, level=2.0)]
    objects = [boxes(rng, 6, 0, scale=0.25), sheet(rng, 9), pair, nested]
    ids = np.repeat(rng.integers(0, len(objects), 60), 2)
    transforms = placements(rng, len(ids))
    worlds = rng.integers(-1, 2, len(ids)) if has_worlds else None
    return rs.Scene.instances(
        objects, transforms, ids, worlds=worlds, materials=MATERIALS, camera=CAMERA
    )


def balls():
    """Centres and radii of spheres of many sizes; some coincide."""
    rng = np.random.default_rng(4)
    centers, radii = rng.integers(-32, 33, (400, 3)), rng.integers(1, 64, 400) / 16.0
    centers[::20], radii[::20] = centers[1::20], radii[1::20]
    return centers, radii


def spheres():
    """A scene of `balls`."""
    ids = np.arange(400) % len(MATERIALS)
    return rs.Scene.spheres(*balls(), material_ids=ids, materials=MATERIALS, camera=CAMERA)


def height_field():
    """Terrain with holes; y is up for the camera, z for the heights."""
    rng = np.random.default_rng(5)
    heights = heights_of(rng, 45, 61)
    heights[rng.random(heights.shape) < 0.04] = np.nan
    return rs.Scene.height_field(heights, origin=(-30.0, -22.0, 0.5), camera=CAMERA)


def mixed():
    """Meshes, a height field and spheres together."""
    return rs.Scene.combine([blocks(), height_field(), spheres()], camera=CAMERA)


def corners_of(scene):
    """Triangles to aim at, (N, 3, 3): those of the meshes, or points on spheres and terrain."""
    if scene.placements is not None:
        scene = scene.flattened()
    corners = [mesh.vertices[mesh.faces] for mesh in scene.meshes]
    if scene.has_primitives:
        centers, radii = balls()
        corners.append(centers[:, None] + radii[:, None, None] * np.eye(3))
        rows, columns = np.meshgrid(np.arange(44.0) - 22, np.arange(60.0) - 30, indexing="ij")
        places = np.stack([columns, rows, np.zeros_like(rows)], -1).reshape(-1, 1, 3)
        corners.append(places + [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    found = np.concatenate(corners)
    return found[np.isfinite(found).all(axis=(1, 2))]


def ray_kinds(scene, corners, count, seed, world_count=0):
    """Some `count` rays in six kinds, each as the arguments of a query."""
    rng = np.random.default_rng(seed)
    count //= 5
    low, high = scene.bounds
    extent = high - low
    size = float(extent.max())
    side = int(count**0.5)
    steps = np.arange(1 - side, side, 2) / side
    across = np.stack(np.meshgrid(steps, steps), -1)
    primary = np.concatenate([0.75 * across, np.ones((side, side, 1))], -1)
    inside, ends = (low + rng.random((count, 3)) * extent for _ in range(2))
    around = rng.integers(-(2**16), 2**16, (count, 3)) / 2.0**16
    picked = corners[rng.integers(0, len(corners), count)]
    is_vertex = rng.random((count, 1)) < 0.5
    at = np.where(is_vertex, picked[:, 0], (picked[:, 0] + picked[:, 1]) / 2)
    outside = (low + high) / 2 + 4 * size * around
    axis = np.eye(3)[rng.integers(0, 3, count)] * rng.choice([-1.0, 1.0], (count, 1))
    through = np.where(rng.random((count, 1)) < 0.5, inside, at)
    kinds = [
        (low + extent * [0.375, 0.5625, 0.4375], primary, 0.0, np.inf),
        (inside.astype(np.float32), around.astype(np.float32), 0.0, np.inf),
        (inside, ends - inside, 2.0**-13, 0.5 + rng.random(count)),
        (outside, at - outside, 0.0, np.inf),  # through vertices and edges
        (through - 2.0**13 * size * axis, np.ldexp(axis, rng.integers(-20, 20)), 0.0, np.inf),
        strange_rays(inside[:64].copy(), around[:64].copy()),
    ]
    for kind in kinds:
        rays = dict(zip(("origins", "directions", "t_min", "t_max"), kind, strict=True))
        if world_count:
            shape = rays["directions"].shape[:-1]
            rays["worlds"] = rng.integers(0, world_count, shape)
        yield rays


def strange_rays(origins, directions):
    """Rays of which seven in eight are invalid, hardly valid, or have no interval."""
    t_min, t_max = np.zeros(len(origins)), np.full(len(origins), np.inf)
    directions[0::8] = 0.0
    origins[1::8, 0] = np.nan
    directions[2::8, 1] = np.inf
    t_min[3::8] = np.nan
    t_max[4::8] = -1.0
    directions[5::8] *= 2.0**-140
    t_max[6::8] = 0.0
    return origins, directions, t_min, t_max
