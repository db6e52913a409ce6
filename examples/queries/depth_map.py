"""
A depth camera
==============

The distance along the view axis in every pixel, as a depth camera reports it.
"""

import numpy as np

import raystream as rs

width, height = 320, 240
scene = rs.load("robots")
tracer = rs.Tracer(scene)

origins, directions = scene.camera.rays(width, height)
hits = tracer.first_hit(origins, directions)

# hits.t is the distance along each ray; a depth camera measures along its axis.
forward = scene.camera.basis()[2]
depth = hits.t * (directions @ forward.astype(np.float32))

grey = np.where(hits.is_hit, depth.min() / depth, 0)  # near is white
rs.Image(np.repeat(grey[..., None], 3, axis=2)).save("depth.png")
np.save("depth.npy", depth.astype(np.float32))
print(
    f"depth.png, depth.npy: {np.count_nonzero(hits.is_hit):,} of {depth.size:,} pixels have depth"
)
print(f"nearest {depth.min():.2f}, median {np.median(depth[hits.is_hit]):.2f}")
