"""Parts of `same_bits` for masks, and for what each kind of scene shares with plain triangles.

Every structure and kernel has the same digests in a case: brute force is among them.
"""

from functools import partial

import bits_scenes as made
import numpy as np
from bits_cases import BRUTE, FEW, KERNELS, NEAREST, columns, filtered, program_answers, tracer_of

import raystream as rs

#: Masks of meshes, instances, spheres and height fields in turn, and of rays.
MASKS = (0b01, 0b10, 0b11, 0b100)
RAY_MASKS = (0b01, 0b10, 0b101, 0b1000, 2**32 - 1)

DOUBLE = {
    f"{label}, float64": {**options, "precision": "float64"}
    for label, options in (KERNELS | BRUTE).items()
    if label != "bvh, wavefront"  # which float64 does not have
}


def masked_scenes():
    """Scenes whose parts have masks; and with instances, masks of these or of their meshes."""
    blocks = made.blocks()
    meshes = [one.with_mask(MASKS[k % 4]) for k, one in enumerate(blocks.meshes)]
    yield "blocks", blocks.replace(meshes=meshes)
    rng = np.random.default_rng(18)
    parts = [made.boxes(rng, 6, 0, scale=0.25), made.boxes(rng, 3, 1, scale=0.125)]
    parts = [
        one.with_mask(mask) for one, mask in zip([*parts, made.sheet(rng, 9)], MASKS, strict=False)
    ]
    yield (
        "instances",
        rs.Scene.instances(
            [parts[0], parts[1:]],
            made.placements(rng, 80),
            np.arange(80) % 2,
            masks=np.resize((*MASKS, 0), 80),
            materials=made.MATERIALS,
        ),
    )
    centers, radii = made.balls()
    balls = [rs.Scene.spheres(centers[k::4], radii[k::4], mask=MASKS[k]) for k in range(4)]
    fields = [
        rs.Scene.height_field(made.heights_of(rng, 45, 61), origin=(-30, -22, 8 * k), mask=mask)
        for k, mask in enumerate(MASKS[:2])
    ]
    yield "mixed", rs.Scene.combine([blocks.replace(meshes=meshes), *fields, *balls])


def masked_answers(scene, label, options, rays):
    """Yield the answers of rays that have masks, alone and with a filter."""
    tracer = tracer_of(scene, label, options)
    for one in rays:
        shape = one["directions"].shape[:-1]
        masks = np.resize(np.array(RAY_MASKS, np.uint32), shape)
        yield "masks", filtered(tracer, one, {"mask": masks})
        yield "mask", filtered(tracer, one, {"mask": 0b10})
        yield "mask, filter", filtered(tracer, one, {"mask": masks, "on_hit": is_even})


def is_even(hit):
    """A filter."""
    return hit.prim_id % 2 == 0


def masks(count):
    """Masks of rays and of what they meet."""
    for name, scene in masked_scenes():
        rays = list(made.ray_kinds(scene, made.corners_of(scene), min(count, FEW), 19))
        for label, options in (KERNELS | BRUTE).items():
            yield f"masks: {name}: {label}", partial(masked_answers, scene, label, options, rays)


def kinds():
    """Scenes of each kind, and tracers for them."""
    alike = KERNELS | BRUTE
    for name in ("spheres", "height_field", "mixed"):
        yield name, getattr(made, name)(), alike
    yield "blocks", made.blocks(), DOUBLE


def kind_programs(count):
    """Filters, programs and skipped triangles of spheres, height fields and float64."""
    for name, scene, tracers in kinds():
        rays = list(made.ray_kinds(scene, made.corners_of(scene), min(count, FEW // 3), 20))
        for label, options in tracers.items():
            yield (
                f"kind_programs: {name}: {label}",
                partial(program_answers, scene, label, options, rays),
            )


def point_answers(scene, label, options, points):
    """Yield the points nearest to points, and whether these are inside."""
    tracer = tracer_of(scene, label, options)
    names, limit = (*NEAREST, "instance_id"), np.linspace(0.0, 8.0, len(points))
    yield "closest", columns(tracer.closest_point(points), names)
    yield "closest, limit", columns(tracer.closest_point(points, max_distance=limit), names)
    yield "closest 4", columns(tracer.closest_points(points, 4), names)
    yield "signed", [tracer.signed_distance(points, method="winding")]
    yield "contains", [tracer.contains(points, method="winding")]


def kind_points(count):
    """Closest points and inside tests of instances, spheres, height fields and float64."""
    for name, scene, tracers in (("instances", made.instances(), KERNELS | BRUTE), *kinds()):
        rng = np.random.default_rng(21)
        low, high = scene.bounds
        anywhere = low + (high - low) * (1.5 * rng.random((600, 3)) - 0.25)
        corners = made.corners_of(scene)
        at = corners[rng.integers(0, len(corners), 300), 0]
        beside = at + rng.integers(-4, 5, at.shape) / 64
        strange = [[np.nan, 0, 0], [0, np.inf, 0], [1e9, 0, 0], [0, -1e30, 0]]
        points = np.concatenate([anywhere, at, beside, strange])[: max(count, 8)]
        for label, options in tracers.items():
            if "kernel" not in options:
                yield (
                    f"kind_points: {name}: {label}",
                    partial(point_answers, scene, label, options, points),
                )


def factor_answers(scene, patches):
    """Yield view factors."""
    for is_two_sided in (False, True):
        found = rs.view_factors(scene, patches, rays=1024, two_sided=is_two_sided)
        yield "view factors", list(found)


def kind_sight(count):  # noqa: ARG001
    """View factors of instances and spheres."""
    placed = made.instances()
    yield "kind_sight: instances", partial(factor_answers, placed, None)
    spheres = made.spheres()
    yield "kind_sight: spheres", partial(factor_answers, spheres, np.arange(400) % 7 - 1)


PARTS = {one.__name__: one for one in (masks, kind_programs, kind_points, kind_sight)}
