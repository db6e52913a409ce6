"""Scenes of parts with masks; and their bits without the parts that a mask leaves out.

What is left has other ids, which are mapped back. Each scene has a part with all bits that reaches
as far as any: so the frame in which rays are traced is the same.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

import raystream as rs
from meshes import cube, icosphere, soup
from raystream.core.masks import ALL_BITS

COLUMNS = ("t", "u", "v", "prim_id", "instance_id")

#: Masks of rays: of all and of none of the parts, and of some.
RAY_MASKS = (0, 1, 2, 5, ALL_BITS)

#: Masks of parts; the next one has all bits.
PART_MASKS = (1, 2, 4, 1 | 2, 8)


class MaskCase(NamedTuple):
    """A scene of parts.

    Attributes
    ----------
    make : callable
        ``make(chosen)`` is the scene of some parts, by their indices.
    masks : ndarray of int64
        Their masks.
    """

    make: Callable[[Sequence[int]], rs.Scene]
    masks: np.ndarray

    @property
    def scene(self) -> rs.Scene:
        """All parts."""
        return self.make(range(len(self.masks)))


class Left(NamedTuple):
    """A tracer of the parts that a mask leaves, and their indices."""

    tracer: rs.Tracer
    kept: np.ndarray

    def columns(self, hits: Any, splits: np.ndarray) -> dict[str, np.ndarray]:
        """Columns of hits with the ids of the whole scene, whose meshes have these splits."""
        own, mesh = self.tracer.structure.triangles.mesh_splits, hits.mesh_id
        is_hit = hits.prim_id >= 0
        columns = {name: getattr(hits, name) for name in COLUMNS}
        if len(self.kept):
            prim_id = hits.prim_id - own[mesh] + splits[self.kept[mesh]]
            columns["prim_id"] = np.where(is_hit, prim_id, -1)
            if self.tracer.structure.triangles.instances is not None:
                columns["instance_id"] = np.where(is_hit, self.kept[hits.instance_id], -1)
        return columns


def left_of(case: MaskCase, masks: Any = RAY_MASKS, **options: Any) -> dict[int, Left]:
    """Brute force in the scene without what each of some masks leaves out."""
    found = {}
    for mask in np.unique(masks).tolist():
        kept = np.flatnonzero(case.masks & mask)
        found[mask] = Left(rs.Tracer(case.make(kept), "brute", **options), kept)
    return found


def _shape(k: int) -> rs.Mesh:
    if k == len(PART_MASKS):
        corner = np.array([[0, 0, 0], [0.5, 0, 0], [0, 0.5, 0.1]])
        points = np.concatenate([corner - 4.5, corner + 4.0, soup(40, 2)[0]])
        return rs.Mesh(points, np.arange(len(points)).reshape(-1, 3))
    points, faces = (soup(80, 1), icosphere(2), cube(), icosphere(2), soup(40, 3))[k]
    return rs.Mesh(np.asarray(points) + np.random.default_rng(k).uniform(-1.0, 1.0, 3), faces)


_SHAPES = [_shape(k) for k in range(len(PART_MASKS) + 1)]


def of_meshes(masks: Sequence[int] = PART_MASKS) -> MaskCase:
    """Meshes."""
    own = [*masks, ALL_BITS]
    meshes = [one.with_mask(int(mask)) for one, mask in zip(_SHAPES, own, strict=True)]
    return MaskCase(lambda chosen: rs.Scene([meshes[k] for k in chosen]), np.array(own))


def of_instances(masks: Sequence[int] = PART_MASKS, *, has_worlds: bool = False) -> MaskCase:
    """Instances of a mesh each: some have masks, others those of their meshes."""
    rng = np.random.default_rng(3)
    parts = [0, 1, 2, 3, 4, 0, 1, 2, 3, 4, 5]
    places = np.zeros((len(parts), 3, 4))
    places[:, :, :3] = np.eye(3) * rng.uniform(0.5, 1.5, (len(parts), 1, 1))
    places[:, :, 3] = rng.uniform(-1.0, 1.0, (len(parts), 3))
    places[-1] = 3.0 * np.eye(3, 4)
    held = np.array([*masks, ALL_BITS])[parts]
    meshes = [_SHAPES[part].with_mask(int(mask)) for part, mask in zip(parts, held, strict=True)]
    own = np.zeros(len(parts), np.int64)
    own[5:10] = np.roll(masks, 2)

    def make(chosen: Sequence[int]) -> rs.Scene:
        rows = np.array(chosen, int)
        objects = [meshes[k] for k in rows]
        given = {"worlds": rows % 3 - 1} if has_worlds else {}
        return rs.Scene.instances(
            objects, places[rows], np.arange(len(rows)), masks=own[rows], **given
        )

    return MaskCase(make, np.where(own > 0, own, held))


def of_all_kinds(masks: Sequence[int] = PART_MASKS) -> MaskCase:
    """Meshes, a height field and spheres."""
    rng, case = np.random.default_rng(5), of_meshes(masks)
    heights, places = rng.uniform(-1.0, 1.0, (9, 9)), rng.uniform(-2.0, 2.0, (30, 3))
    others = [
        rs.Scene.height_field(heights, origin=(-2, -2, 0), spacing=0.5, mask=int(masks[1])),
        rs.Scene.spheres(places, 0.4, mask=int(masks[2])),
    ]
    count = len(case.masks)

    def make(chosen: Sequence[int]) -> rs.Scene:
        more = [others[k - count] for k in chosen if k >= count]
        return rs.Scene.combine([case.make([k for k in chosen if k < count]), *more])

    return MaskCase(make, np.append(case.masks, masks[1:3]))


def check(tracer: rs.Tracer, left: dict[int, Left], rays: Any, masks: Any, **more: Any) -> None:
    """Compare all queries of rays with a mask each with those of scenes without the parts."""
    given: dict[str, Any] = {"mask": masks, **more}
    first, seen = tracer.first_hit(*rays, **given), tracer.any_hit(*rays, **given)
    count, many = tracer.count_hits(*rays, **given), tracer.multi_hit(*rays, **given)
    few = tracer.multi_hit(*rays, **given, max_hits=2)
    rows = np.broadcast_to(masks, first.t.shape)
    splits = tracer.structure.triangles.mesh_splits
    for mask, one in left.items():
        mine, other = np.flatnonzero(rows == mask), one.tracer
        some = [np.broadcast_to(part, (*first.t.shape, 3))[mine] for part in rays]
        others = {key: value[mine] for key, value in more.items()}
        if "worlds" in others and not other.structure.triangles.world_count:
            del others["worlds"]
        expected = one.columns(other.first_hit(*some, **others), splits)
        for name, values in expected.items():
            np.testing.assert_array_equal(getattr(first, name)[mine], values)
        np.testing.assert_array_equal(seen[mine], other.any_hit(*some, **others))
        np.testing.assert_array_equal(count[mine], other.count_hits(*some, **others))
        for found, limit in ((many, None), (few, 2)):
            reference = other.multi_hit(*some, **others, max_hits=limit)
            chosen = np.isin(found.ray_id, mine)
            for name, values in one.columns(reference, splits).items():
                np.testing.assert_array_equal(getattr(found, name)[chosen], values)


def some_rays(count: int, seed: int, coherent: bool) -> tuple[Any, Any]:
    """Rays of a camera, or at random."""
    rng = np.random.default_rng(seed)
    if coherent:
        side = int(count**0.5)
        axis = np.linspace(-0.4, 0.4, side)
        directions = np.stack(np.broadcast_arrays(axis, axis[:, None], 1.0), axis=-1)
        return np.array([0.1, 0.2, -5.0]), directions.reshape(-1, 3)
    return rng.uniform(-3.0, 3.0, (count, 3)), rng.normal(size=(count, 3))


def some_masks(count: int) -> np.ndarray:
    """The mask of each ray."""
    return np.random.default_rng(2).choice(RAY_MASKS, count)
