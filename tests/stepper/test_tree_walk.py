"""Walks through instances, spheres, height fields and float64 end at the tracer's hits."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import raystream as rs
from held_hits import KINDS, tracer_and_rays
from raystream.machines.records import RayState
from raystream.stepper import walk


@pytest.mark.parametrize("kind", KINDS)
def test_walks_end_at_the_hit(kind) -> None:
    tracer, origins, directions = tracer_and_rays(kind)
    hits = tracer.first_hit(origins, directions)
    for k, (origin, direction) in enumerate(zip(origins, directions, strict=True)):
        walked = walk(tracer, origin, direction)
        found = walked.t, walked.prim_id, walked.instance_id
        assert found == (hits.t[k], hits.prim_id[k], hits.instance_id[k])
        check_steps(walked, origin, direction)


def check_steps(walked, origin, direction) -> None:
    steps = walked.steps
    assert steps[0].kernel == "set up"
    assert (steps[0].before, steps[-1].after) == (RayState.STARTING, RayState.DONE)
    for one, after in itertools.pairwise(steps):
        assert one.after is after.before
        assert one.to == after.at
        assert one.t >= after.t
    assert walked.counts["tests"] == sum(len(step.tested) for step in steps)
    assert walked.counts["leaves"] + walked.counts["steps"] == sum(
        step.kernel == "traverse" for step in steps
    )
    for step in steps:
        at = step.at
        if at is None or at.t_in > at.t_out:  # of a root that the ray misses
            continue
        low, high = np.array(at.low), np.array(at.high)
        slack = 1e-4 * max(np.abs([low, high]).max(), np.abs(origin).max())
        for t in (at.t_in, min(at.t_out, 1e6)):
            point = origin + t * direction
            assert (point >= low - slack).all()
            assert (point <= high + slack).all()
    if walked.prim_id >= 0:
        own = [step for step in steps if walked.prim_id in step.tested]
        assert any(step.t == walked.t for step in own)


def test_a_walk_enters_instances_by_their_tree() -> None:
    ball = rs.Scene.from_arrays(np.eye(3), [[0, 1, 2]])
    places = np.tile(np.eye(3, 4), (3, 1, 1))
    places[:, 0, 3] = (0.0, 5.0, 10.0)
    tracer, ray = rs.Tracer(rs.Scene.instances(ball, places)), ([-9, 0.25, 0.25], [1, 0, 0])
    walked = walk(tracer, *ray)
    kinds = [step.at.kind for step in walked.steps if step.at is not None]
    assert kinds == ["node", "instance", "node", "leaf", "leaf"]
    assert [step.kernel for step in walked.steps][-2:] == ["intersect", "shade"]
    assert (walked.prim_id, walked.instance_id, walked.t) == (0, 0, 9.5)
    inside = [step.at for step in walked.steps if step.kernel == "intersect"]
    assert [(at.low, at.high) for at in inside] == [((0, 0, 0), (1, 1, 1))]
    # Nothing beyond the hit is entered: the others wait until then.
    assert max(len(step.stack) for step in walked.steps) == 2
    short = walk(
        rs.Tracer(rs.Scene.instances(ball, places)), [-9, 0.25, 0.25], [1, 0, 0], max_steps=2
    )
    assert (len(short.steps), short.is_whole, short.prim_id) == (2, False, -1)


def test_a_walk_needs_a_tree_and_a_ray() -> None:
    balls = rs.Scene.spheres([[0, 0, 0]], 1.0)
    with pytest.raises(ValueError, match="expected a tracer of a bvh, got one of 'brute'"):
        walk(rs.Tracer(balls, "brute"), [0, 0, 5], [0, 0, -1])
    with pytest.raises(ValueError, match="is invalid"):
        walk(rs.Tracer(balls), [0, 0, 5], [0, 0, 0])
    with pytest.raises(ValueError, match="expected one ray"):
        walk(rs.Tracer(balls), [[0, 0, 5]] * 2, [0, 0, 1])
    assert walk(rs.Tracer(balls), [0, 0, 5], [0, 0, -1]).t == 4.0
    assert walk(rs.Tracer(balls), [0, 0, 5], [0, 0, 1]).t == np.inf
