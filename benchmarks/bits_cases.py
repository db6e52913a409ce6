"""The parts of `same_bits`: what is asked of which scenes and tracers.

Only the public interface is used, so that versions far apart can be compared. Each part is a
generator of cases: pairs of a label and a function without arguments, which yields pairs of a
query's name and arrays of its answer. A label without a function is a scene that is not available.
"""

import os
import tempfile
from functools import partial
from pathlib import Path

import bits_scenes as made
import numpy as np

import raystream as rs
from raystream.programs import Bound

BUILT_IN = ("cornell", "spheres", "robots", "building")
MODELS = ("bunny", "sponza", "conference", "sibenik")

#: Rays of a scene for all tracers but the default one, and for all queries but plain ones.
FEW = 4_500

#: Triangles of a scene whose grid is searched in passes: with more of them that takes minutes.
MOST_IN_PASSES = 10_000

#: Kernels of the BVH, for every kind of scene.
KERNELS = {
    "bvh": {},
    "bvh, wavefront": {"kernel": "wavefront"},
    "bvh, packet": {"kernel": "packet"},
    "bvh, groups": {"kernel": "groups"},
    "bvh, single": {"kernel": "single"},
    "bvh, fast": {"quality": "fast"},
}
BRUTE = {"brute": {}}
OTHERS = {
    "kdtree, stack": {"traversal": "stack"},
    "kdtree, restart": {"traversal": "restart"},
    "kdtree, backtrack": {"traversal": "backtrack"},
    "graph": {},
    "grid": {},
    "bvh, multipass": {"machine": "multipass"},
    "grid, multipass": {"machine": "multipass"},
}

FIRST = ("t", "u", "v", "prim_id", "instance_id", "status")
ROWS = ("ray_splits", "t", "u", "v", "prim_id", "instance_id")
DERIVED = ("positions", "normals", "shading_normals", "texcoords", "mesh_id", "material_id")
NEAREST = ("distance", "positions", "u", "v", "prim_id", "status")
SEGMENTS = ("ray_splits", "t_entry", "t_exit", "path_length", "mesh_id", "material_id")
SEGMENTS += ("entry_prim_id", "exit_prim_id", "instance_id", "status", "is_complete")
SEGMENTS += ("unpaired_ray", "unpaired_t", "unpaired_prim_id", "unpaired_mesh_id")
SEGMENTS += ("unpaired_kind", "unpaired_instance_id", "mesh_is_closed", "mesh_is_flipped")
RETURNS = ("ray_splits", "ranges", "positions", "intensity", "incidence_angle", "return_number")
RETURNS += ("return_count", "prim_id", "mesh_id", "material_id", "instance_id", "status")
SWEEP = ("time", "channel", "column", "origins", "directions", "sensor_positions")


def columns(found, names):
    """The named columns of an answer."""
    return [getattr(found, name) for name in names]


def tracer_of(scene, label, options):
    """A tracer by its label, which begins with the name of the structure."""
    return rs.Tracer(scene, label.partition(",")[0], **options)


def inputs_of(scene, corners, rays):
    """The scene and the rays themselves: where these differ, answers cannot be equal."""
    yield "inputs", [scene.bounds, corners, *(array for one in rays for array in one.values())]


def answers(scene, label, options, rays):
    """Yield the answers to all queries of rays, for rays of each kind."""
    tracer = tracer_of(scene, label, options)
    for one in rays:
        first = tracer.first_hit(**one)
        yield "first", columns(first, FIRST)
        yield "derived", [*columns(first, DERIVED), *first.spawn(-one["directions"])]
        yield "any", [tracer.any_hit(**one)]
        for suffix, crossings in (("", "triangles"), (" surfaces", "surfaces")):
            more = {**one, "crossings": crossings}
            yield f"count{suffix}", [tracer.count_hits(**more)]
            yield f"multi{suffix}", columns(tracer.multi_hit(**more), ROWS)
            yield f"multi 3{suffix}", columns(tracer.multi_hit(**more, max_hits=3), ROWS)
        if "worlds" not in one:
            yield "cast", [cast(tracer, **one)]


def cast(tracer, origins, directions, t_min, t_max):
    """The hits of a few rays, one at a time."""
    shape = directions.shape[:-1]
    limits = (np.broadcast_to(limit, shape).ravel().tolist() for limit in (t_min, t_max))
    places = np.broadcast_to(origins, directions.shape).reshape(-1, 3).tolist()
    rays = zip(places, directions.reshape(-1, 3).tolist(), *limits, strict=True)
    hits = [tracer.cast(*ray) for ray, _ in zip(rays, range(32), strict=False)]
    return np.array([(*hit, hit.instance_id, int(hit.status)) for hit in hits])


def queries(part, name, scene, corners, count, tracers, world_count=0):
    """Cases of a scene: all queries, with many rays for the first tracer, few for the others."""
    many, few = (
        list(made.ray_kinds(scene, corners, number, len(name), world_count))
        for number in (count, min(FEW, count))
    )
    yield f"{part}: {name}: inputs", partial(inputs_of, scene, corners, many)
    for label, options in tracers.items():
        rays = many if label == next(iter(tracers)) else few
        yield f"{part}: {name}: {label}", partial(answers, scene, label, options, rays)


def plain(count):
    """Scenes of triangles."""
    has_models = "RAYSTREAM_SCENES" in os.environ  # else they would be downloaded
    for name in (*BUILT_IN, *MODELS):
        if name in MODELS and not has_models:
            yield f"plain: {name}", None
            continue
        scene = rs.load(name)
        tracers = KERNELS | OTHERS
        if scene.triangle_count > MOST_IN_PASSES:
            tracers = {label: tracers[label] for label in tracers if label != "grid, multipass"}
        yield from queries("plain", name, scene, made.corners_of(scene), count, tracers)
    for name, shift in (("blocks", 0.0), ("far blocks", made.FAR)):
        scene = made.blocks(shift)
        tracers = KERNELS | OTHERS | BRUTE
        yield from queries("plain", name, scene, made.corners_of(scene), count, tracers)


def float64(count):
    """The same in float64."""
    tracers = {
        label: {**options, "precision": "float64"}
        for label, options in (KERNELS | BRUTE).items()
        if label != "bvh, wavefront"  # which float64 does not have
    }
    for name, shift in (("blocks", 0.0), ("far blocks", made.FAR)):
        scene = made.blocks(shift)
        yield from queries("float64", name, scene, made.corners_of(scene), count, tracers)


def instances(count):
    """Instances, mirrored, sheared and scaled; and in two worlds."""
    scene = made.instances()
    corners = made.corners_of(scene)
    yield from queries("instances", "placed", scene, corners, count, KERNELS | BRUTE)
    scene = made.instances(has_worlds=True)
    yield from queries("instances", "worlds", scene, corners, count, KERNELS | BRUTE, 2)


def primitives(count):
    """Spheres and height fields."""
    for name in ("spheres", "height_field", "mixed"):
        scene = getattr(made, name)()
        corners = made.corners_of(scene)
        yield from queries("primitives", name, scene, corners, count, KERNELS | BRUTE)


def point_answers(scene, label, options, points):
    """Yield the answers to queries of points."""
    tracer = tracer_of(scene, label, options)
    if label in ("bvh", "brute"):
        limit = np.linspace(0.0, 8.0, len(points))
        yield "closest", columns(tracer.closest_point(points), NEAREST)
        yield "closest, limit", columns(tracer.closest_point(points, max_distance=limit), NEAREST)
        yield "closest 4", columns(tracer.closest_points(points, 4), NEAREST)
        for method in ("rays", "winding"):
            yield f"signed {method}", [tracer.signed_distance(points, method=method)]
        for accuracy in (0.0, 2.0**-10):
            yield f"winding {accuracy}", [tracer.winding_number(points, accuracy=accuracy)]
    for method in ("rays", "winding"):
        yield f"contains {method}", [tracer.contains(points, method=method)]


def points(count):
    """Closest points and inside tests, for points anywhere, on surfaces and beside them."""
    for name, shift in (("solids", 0.0), ("far solids", made.FAR)):
        scene = made.solids()
        scene = scene.replace(meshes=[one.moved(one.vertices + shift) for one in scene.meshes])
        corners = made.corners_of(scene)
        rng = np.random.default_rng(8)
        low, high = scene.bounds
        anywhere = low + (high - low) * (1.5 * rng.random((2000, 3)) - 0.25)
        picked = corners[rng.integers(0, len(corners), 1500)]
        on_edges = (picked[:500, 0] + picked[:500, 1]) / 2
        beside = picked[500:1000, 0] + rng.integers(-4, 5, (500, 3)) / 64
        strange = [[np.nan, 0, 0], [0, np.inf, 0], [1e9, 0, 0], [0, -1e30, 0]]
        given = np.concatenate([anywhere, on_edges, beside, picked[1000:, 0], strange])
        for label, options in (KERNELS | OTHERS | BRUTE).items():
            if "kernel" not in options or label == "bvh, packet":
                yield (
                    f"points: {name}: {label}",
                    partial(point_answers, scene, label, options, given[: min(count, len(given))]),
                )


RECORD = np.dtype([("count", "i4"), ("front", "i4"), ("ids", "i8"), ("t", "f8"), ("weights", "f8")])


def is_kept(hit):
    """A filter of triangles and instances."""
    return (hit.prim_id + hit.instance_id) % 3 != 0


def is_kept_among(hit, constants):
    """A filter with constants, of all that a hit has."""
    is_left_out = hit.is_entering and hit.u < constants[0]
    if is_left_out or hit.mesh_id == constants[1] or hit.t < constants[2] or hit.v > 0.75:
        return rs.Decision.IGNORE
    return rs.Decision.CONTINUE


def add_up(hit, payload):
    """A program of which the order matters."""
    payload.count += 1
    payload.front += payload.count if hit.is_entering else 0
    payload.ids = 31 * payload.ids + 7 * hit.prim_id + 3 * hit.mesh_id + hit.instance_id
    payload.t += hit.t * payload.count
    payload.weights += hit.u - 2.0 * hit.v


def first_three(hit, payload):
    """A program that stops."""
    payload[0] += 1
    payload[1] = hit.prim_id
    return rs.Decision.STOP if payload[0] == 3 else rs.Decision.CONTINUE


def count_odd(hit, payload):
    """A program of which the order does not matter."""
    payload[0] += 1
    payload[1] += hit.prim_id % 2


def filtered(tracer, rays, options):
    """The columns of the four queries' answers, with options."""
    first, many = tracer.first_hit(**rays, **options), tracer.multi_hit(**rays, **options)
    nearest = tracer.multi_hit(**rays, **options, max_hits=2, crossings="surfaces")
    counts = tracer.count_hits(**rays, **options, crossings="surfaces")
    rows = [*columns(first, FIRST), *columns(many, ROWS), *columns(nearest, ROWS), counts]
    return [*rows, tracer.any_hit(**rays, **options), tracer.count_hits(**rays, **options)]


def program_answers(scene, label, options, rays):
    """Yield the answers of filters, of programs, and of queries that skip triangles."""
    tracer = tracer_of(scene, label, options)
    for one in rays:
        yield "filter", filtered(tracer, one, {"on_hit": is_kept})
        bound = Bound(is_kept_among, (0.25, 1, 0.125))
        yield "filter, bound", filtered(tracer, one, {"on_hit": bound})
        first = tracer.first_hit(**one)
        second = tracer.first_hit(**one, skip_prim_ids=first.prim_id)
        both = np.stack([first.prim_id, second.prim_id], -1)
        yield "skip", filtered(tracer, one, {"skip_prim_ids": both})
        yield "skip hits", filtered(tracer, one, {"skip_prim_ids": first, "on_hit": is_kept})
        for crossings in ("triangles", "surfaces"):
            more = {**one, "crossings": crossings}
            found = tracer.trace(**more, on_hit=add_up, payload=RECORD)
            yield "trace", [found[name] for name in RECORD.names]
            pairs = np.zeros((*one["directions"].shape[:-1], 2), np.int64)
            yield "trace, stop", [tracer.trace(**more, on_hit=first_three, payload=pairs)]
            pairs = np.zeros_like(pairs)
            found = tracer.trace(**more, on_hit=count_odd, payload=pairs, order="any")
            yield "trace, any order", [found]


def programs(count):
    """Filters, programs and skipped triangles."""
    few = min(count, FEW)
    default = {"bvh": {}}
    for name, scene, world_count, tracers in (
        ("blocks", made.blocks(), 0, KERNELS | OTHERS | BRUTE),
        ("instances", made.instances(), 0, KERNELS | BRUTE),
        ("worlds", made.instances(has_worlds=True), 2, default),
    ):
        corners = made.corners_of(made.instances() if world_count else scene)
        rays = list(made.ray_kinds(scene, corners, few, 9, world_count))
        for label, options in tracers.items():
            yield (
                f"programs: {name}: {label}",
                partial(program_answers, scene, label, options, rays),
            )


def update_answers(scene, label, options, rays, changes):
    """Yield the answers after each of several updates."""
    tracer = tracer_of(scene, label, options)
    for step, change in enumerate(changes):
        report = tracer.update(**change)
        yield f"step {step}", [np.array(report.rebuilt)]
        for one in rays:
            yield f"step {step}", columns(tracer.first_hit(**one), FIRST)
            yield f"step {step}", columns(tracer.multi_hit(**one, crossings="surfaces"), ROWS)


def update(count):
    """Tracers whose vertices and instances move: a little, then far, then back."""
    few, rng = min(count, FEW), np.random.default_rng(10)
    scene = made.blocks()
    rays = list(made.ray_kinds(scene, made.corners_of(scene), few, 11))
    vertices = [mesh.vertices for mesh in scene.meshes]
    little = [one + rng.integers(-2, 3, one.shape) / 16 for one in vertices[:-1]]
    far = [rng.permutation(one) * [1, 2, -1] for one in vertices]
    changes = [{"vertices": one} for one in ([*little, None], far, vertices)]
    double = {"bvh, float64": {"precision": "float64"}}
    for label, options in (KERNELS | OTHERS | BRUTE | double).items():
        yield (
            f"update: blocks: {label}",
            partial(update_answers, scene, label, options, rays, changes),
        )
    scene = made.instances()
    rays = list(made.ray_kinds(scene, made.corners_of(scene), few, 12))
    places = made.placements(rng, len(scene.placements))
    changes = [{"transforms": places}, {"vertices": scene.with_transforms(places[::-1])}]
    for label, options in (KERNELS | BRUTE).items():
        yield (
            f"update: instances: {label}",
            partial(update_answers, scene, label, options, rays, changes),
        )


def file_answers(scene, folder):
    """Yield the arrays of hit files."""
    import zarr

    tracer = rs.Tracer(scene)
    for query, options in (
        ("first_hit", {}),
        ("any_hit", {}),
        ("count_hits", {"crossings": "surfaces"}),
        ("multi_hit", {}),
        ("multi_hit", {"crossings": "surfaces", "max_hits": 2}),
    ):
        output = folder / "hits.zarr"
        report = rs.query_zarr(
            tracer, folder / "rays.zarr", output, query, block_rays=1000, **options
        )
        hits = zarr.open_group(output, mode="r")
        arrays = [array[...] for _, array in sorted(hits.arrays())]
        yield query, [*arrays, np.array([report.rays, report.rays_hit, report.hits])]


def files(count):
    """Ray files."""
    import zarr

    for name, scene in (("blocks", made.blocks()), ("instances", made.instances())):
        corners = made.corners_of(scene)
        rays = list(made.ray_kinds(scene, corners, min(count, FEW), 13))[2]
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            group = zarr.create_group(folder / "rays.zarr")
            for key in ("origins", "directions", "t_max"):
                chunks = (300, *rays[key].shape[1:])
                group.create_array(key, data=rays[key], chunks=chunks)
            yield f"files: {name}", partial(file_answers, scene, folder)


def physics_answers(scene, rays, has_triangles):
    """Yield solids along rays, and returns of pulses."""
    tracer = rs.Tracer(scene)
    track = rs.SensorTrack([0, 1], [[-8, 24, 40], [8, 24, 40]])
    for one in rays:
        if has_triangles:
            for ends in ("report", "clip"):
                found = rs.thickness(tracer, **one, ends=ends)
                lengths = found.total_length(), found.total_length(by="material")
                yield f"thickness, {ends}", [*columns(found, SEGMENTS), *lengths]
            yield "attenuation", [rs.attenuation(found, 0.25, incomplete="ignore")]
        passing = {"transmission": 0.5, "reflectance": 0.75, "threshold": 0.0}
        found = rs.lidar_returns(tracer, **one, **passing, separation=0.5)
        yield "lidar", columns(found, RETURNS)
        found = rs.lidar_returns(tracer, **one, **passing, divergence=1.0, sub_rays=7)
        yield "lidar, cones", columns(found, RETURNS)
    directions = rays[0]["directions"].reshape(-1, 3) * [1, 1, -1]
    pattern = rs.sweep_patterns.SweepPattern(
        directions, np.arange(len(directions)) / len(directions), period=1.0
    )
    sweep = rs.lidar_sweep(tracer, pattern, track, time_steps=4)
    yield "sweep", [*columns(sweep, RETURNS + SWEEP), sweep.deskewed()]


def terrain_answers(surface):
    """Yield what is computed from an elevation raster."""
    heights = made.heights_of(np.random.default_rng(14), 50, 60)
    heights[20:25, 30:40] = np.nan
    ground = rs.terrain(heights, spacing=(1.0, -1.0), surface=surface)
    places = np.random.default_rng(15).random((2, 500)) * [[60], [-50]]
    yield "elevation", [ground.elevation(*places)]
    yield "viewshed", [ground.viewshed([20.5, -20.25], 4.0, target_height=1.0)]
    yield (
        "viewshed, curved",
        [ground.viewshed([9.5, -9.5], 2.0, earth_radius=1e4, refraction=0.125)],
    )
    yield "hillshade", [ground.hillshade(shadows=True)]


def moving():
    """Solids of which one moves."""
    scene = made.solids()
    first = scene.meshes[0]

    def at(time):
        moved = first.moved(first.vertices + [8.0 * time, 0.0, 0.0])
        return scene.replace(meshes=[moved, *scene.meshes[1:]])

    return scene.replace(animation=rs.Animation(at, (0.0, 1.0)))


def physics(count):
    """Thickness, attenuation, LiDAR and terrain."""
    for name, scene, has_triangles in (
        ("solids", made.solids(), True),
        ("blocks", made.blocks(), True),
        ("instances", made.instances(), True),
        ("moving", moving(), True),
        ("mixed", made.mixed(), False),
    ):
        rays = list(made.ray_kinds(scene, made.corners_of(scene), min(count, FEW), 16))
        yield f"physics: {name}", partial(physics_answers, scene, rays, has_triangles)
    for surface in ("mesh", "height field"):
        yield f"physics: terrain, {surface}", partial(terrain_answers, surface)


def sight_answers(scene, count):
    """Yield lines of sight, view factors and visible faces."""
    tracer = rs.Tracer(scene)
    rng = np.random.default_rng(17)
    low, high = scene.bounds
    eyes, starts = (low + rng.random((n, 3)) * (high - low) for n in (100, count // 10))
    yield "points", [rs.visibility(tracer, eyes)]
    if scene.has_primitives:
        return
    ends = tracer.first_hit(starts, [0.25, -1.0, 0.125])
    for is_front in (False, True):
        bits = rs.visibility(tracer, ends, eyes, form="bits", front_only=is_front)
        yield "surfaces", [bits, rs.visibility(tracer, ends[:100], front_only=is_front)]
    sparse = rs.visibility(tracer, eyes, ends, form="sparse", skip_b=ends.prim_id)
    yield "sparse", [sparse.indptr, sparse.indices]
    yield "visible faces", list(rs.visible_faces(tracer, made.CAMERA, (96, 72)))
    yield "visible faces, around", list(rs.visible_faces(tracer, [0.5, 30.25, 0.5], (64, 32)))
    if scene.placements is not None:
        return
    ids = np.arange(scene.triangle_count)
    found = rs.surface_points(tracer, ids, 0.25, 0.5)
    yield "surface points", [*columns(found, FIRST), found.positions]
    patches = np.where(ids < len(ids) - 8, ids % 6, -1)
    for is_equal in (False, True):
        found = rs.view_factors(tracer, patches, rays=1024, reciprocity=is_equal)
        yield "view factors", list(found)


def sight(count):
    """Lines of sight."""
    for name in ("blocks", "instances", "mixed"):
        yield f"sight: {name}", partial(sight_answers, getattr(made, name)(), min(count, FEW))


PARTS = {
    part.__name__: part
    for part in (
        plain,
        float64,
        instances,
        primitives,
        points,
        programs,
        update,
        files,
        physics,
        sight,
    )
}
