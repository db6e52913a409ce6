"""Properties of all meshes and rays; hypothesis searches for counterexamples."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs
from cases import Case
from oracles import check_counts, check_first, judge
from strategies import scenes_and_rays
from test_agreement import assert_same_answers

quiet = settings(max_examples=100)


@quiet
@given(scenes_and_rays())
def test_bvh_equals_brute_force(drawn):
    vertices, faces, origins, directions = drawn
    scene = rs.Scene.from_arrays(vertices, faces)
    rays = {"origins": origins, "directions": directions}
    assert_same_answers(rs.Tracer(scene, max_leaf_size=1), rs.Tracer(scene, "brute"), rays)


@pytest.mark.ci
@quiet
@given(
    scenes_and_rays(),
    st.sampled_from(["stack", "restart", "backtrack", "short-stack"]),
    st.sampled_from(["compact", "foley"]),
    st.sampled_from([1.0, 10.0, 1000.0]),
    st.sampled_from([(0.0, np.inf), (-np.inf, np.inf), (0.5, 1.5)]),
)
def test_kdtree_equals_brute_force(drawn, traversal, layout, intersection_cost, limits):
    vertices, faces, origins, directions = drawn
    scene = rs.Scene.from_arrays(vertices, faces)
    rays = {"origins": origins, "directions": directions, "t_min": limits[0], "t_max": limits[1]}
    options = {"traversal": traversal, "layout": layout, "intersection_cost": intersection_cost}
    assert_same_answers(rs.Tracer(scene, "kdtree", **options), rs.Tracer(scene, "brute"), rays)


@quiet
@given(scenes_and_rays(), st.floats(-2, 2, width=32), st.floats(-1, 3, width=32))
def test_intervals_select_among_the_hits(drawn, t_min, length):
    """A closed interval gives just the hits of the whole line that lie in it."""
    vertices, faces, origins, directions = drawn
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces))
    t_min, t_max = np.float32(t_min), np.float32(t_min) + np.float32(length)
    line = tracer.multi_hit(origins, directions, t_min=-np.inf)
    part = tracer.multi_hit(origins, directions, t_min=t_min, t_max=t_max)
    inside = (line.t >= t_min) & (line.t <= t_max)
    np.testing.assert_array_equal(part.t, line.t[inside])
    np.testing.assert_array_equal(part.prim_id, line.prim_id[inside])


@quiet
@given(scenes_and_rays())
def test_hits_are_where_a_float64_oracle_allows_them(drawn):
    vertices, faces, origins, directions = drawn
    case = Case(vertices, faces, origins, directions)
    valid = directions.any(axis=1)
    if not valid.all() or not len(faces) or not case.scene.triangles.prim_ids.size:
        return
    # The oracle knows nothing of unused vertices or of triangles left out.
    solid = case.scene.triangles.prim_ids
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces[solid]))
    verdict = judge(vertices, faces[solid], origins, directions, *case.limits())
    check_counts(verdict, tracer.count_hits(origins, directions))
    hits = tracer.first_hit(origins, directions)
    check_first(verdict, hits.t, hits.prim_id)


@quiet
@given(scenes_and_rays(), st.randoms(use_true_random=False))
def test_shuffling_triangles_changes_nothing_but_numbers(drawn, random):
    vertices, faces, origins, directions = drawn
    order = list(range(len(faces)))
    random.shuffle(order)
    plain = rs.Tracer(rs.Scene.from_arrays(vertices, faces))
    shuffled = rs.Tracer(rs.Scene.from_arrays(vertices, faces[order]))
    np.testing.assert_array_equal(
        plain.first_hit(origins, directions).t, shuffled.first_hit(origins, directions).t
    )
    np.testing.assert_array_equal(
        plain.multi_hit(origins, directions).t, shuffled.multi_hit(origins, directions).t
    )


@quiet
@given(scenes_and_rays())
def test_rays_spawned_at_hits_miss_the_same_triangle(drawn):
    vertices, faces, origins, directions = drawn
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces))
    hits = tracer.first_hit(origins, directions)
    for turned in (directions, -directions, directions[:, ::-1], np.roll(directions, 1, axis=0)):
        again = tracer.multi_hit(*hits.spawn(turned))
        assert not (again.prim_id == hits.prim_id[again.ray_id]).any()
