"""
Save a structure
================

Build an acceleration structure once and use it in many runs.
"""

from pathlib import Path

import numpy as np

import raystream as rs

path = Path("forest.npz")
scene = rs.load("forest", triangles=100_000)

if not path.exists():
    built = rs.Tracer(scene)
    built.save(path)
    print(f"built in {built.structure.report.seconds:.2f} s, saved as {path}")

# The file holds the triangles, too: a query needs nothing else. The scene, given
# here as well, adds the materials and lights for images.
tracer = rs.Tracer.load(path, scene)
low, high = scene.bounds
rng = np.random.default_rng(0)
origins = low + rng.random((10_000, 3)) * (high - low)
sky = tracer.any_hit(origins, [0.0, 1.0, 0.0])
print(f"of {sky.size:,} points, {np.count_nonzero(~sky):,} see the sky straight above")
