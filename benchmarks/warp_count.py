"""A Warp kernel that counts all triangles along a ray, which Warp offers only in kernels."""

# No postponed annotations: Warp reads the annotations of its kernels.

import warp as wp


@wp.kernel(enable_backward=False)
def count_kernel(
    mesh: wp.uint64,
    origins: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    counts: wp.array(dtype=int),
):
    i = wp.tid()
    counts[i] = wp.mesh_query_ray_count_intersections(mesh, origins[i], directions[i])
