"""
First hits
==========

Which triangles the rays of a camera hit, where, and at what angle.
"""

import numpy as np

import raystream as rs

scene = rs.load("spheres")
tracer = rs.Tracer(scene)

# A fan of rays from the scene's camera, from the left to the right of its view.
camera = scene.camera
angles = np.linspace(-0.5, 0.5, 11)
right, up, forward = camera.basis()
directions = np.cos(angles)[:, None] * forward + np.sin(angles)[:, None] * right

hits = tracer.first_hit(camera.eye, directions)
cosines = np.abs(np.einsum("nk,nk->n", hits.normals, directions))
for angle, t, prim_id, cosine in zip(angles, hits.t, hits.prim_id, cosines, strict=True):
    if prim_id < 0:
        print(f"{np.degrees(angle):6.1f} degrees: nothing")
        continue
    tilt = np.degrees(np.arccos(min(cosine, 1.0)))
    place = f"triangle {prim_id} at {t:.3f}, {tilt:.1f} degrees from its normal"
    print(f"{np.degrees(angle):6.1f} degrees: {place}")
