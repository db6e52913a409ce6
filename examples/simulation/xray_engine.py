"""
X-ray of an engine
==================

What a flat detector sees of an engine with pistons, rods, valves and springs of several
materials: parallel rays, and the law of Beer and Lambert along each. The parts are closed solids
inside each other, made by the modules in ``examples/simulation/engine``.

The check is the volume of some parts: the thickness that the rays measure, summed over the
detector, against the volume that the part's triangles enclose.

.. code-block:: console

    $ python examples/simulation/xray_engine.py 1920x1080 64

renders the second image in this size, with this number of samples per pixel. The documentation
shows ``640x480 16``.
"""

import sys

import numpy as np

import raystream as rs
from engine import make_engine

# Attenuation per metre, roughly that of 500 keV.
STEEL, ALUMINIUM = 66.0, 23.0
COEFFICIENTS = {
    **dict.fromkeys(["cast iron", "steel", "turned steel", "exhaust steel", "red paint"], STEEL),
    **dict.fromkeys(["aluminium", "ceramic"], ALUMINIUM),
    **dict.fromkeys(["rubber", "oil", "black paint", "wood"], 9.0),
    "table": 0.0,
}

# A detector of 600 x 440 pixels behind the engine, 1.5 mm each, and parallel rays along z.
scene = make_engine()
tracer = rs.Tracer(scene)
pixel = 0.0015
x, y = np.meshgrid(pixel * np.arange(-300, 300), pixel * np.arange(420, -20, -1))
origins = np.stack([x, y, np.full_like(x, 2.0)], axis=-1)
# Where parts overlap, within their tolerances, the smaller one counts.
found = rs.thickness(tracer, origins, [0.0, 0.0, -1.0], nested="inner")
assert found.is_complete.all()
print(f"{found.mesh_id.size:,} crossings of parts by {x.size:,} rays")

# Thickness times area, summed, is volume. (A part of overlapping solids would count them once.)
lengths = found.total_length(by="mesh")
for name in ("piston 1", "flywheel", "pulley", "intake", "exhaust"):
    number = list(found.mesh_names).index(name)
    mesh = scene.meshes[number]
    a, b, c = mesh.vertices[mesh.faces].astype(float).transpose(1, 0, 2)
    enclosed = np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0
    seen = lengths[..., number].sum() * pixel**2
    print(f"{name}: {1e6 * enclosed:,.0f} cm³ by its triangles, {1e6 * seen:,.0f} by the rays")
    assert abs(seen / enclosed - 1) < 0.015


image = rs.attenuation(found, COEFFICIENTS)
print(f"{image.min():.1e} to {image.max():.2f} of the rays pass")
shade = image ** (1 / 3)  # thick and thin parts are both visible
rs.Image(np.repeat(shade[..., None], 3, axis=-1)).save("xray_engine.png")
print("wrote xray_engine.png")

# %%
# A shotline across the first cylinder, below its piston, with the length in each part.

line = rs.thickness(tracer, [-0.15, 0.325, 1.0], [0.0, 0.0, -1.0], nested="inner")
for number, length in zip(line.mesh_id, line.path_length, strict=True):
    print(f"{1000 * length:5.1f} mm of {line.mesh_names[number]}")
names = [line.mesh_names[number] for number in line.mesh_id]
assert names == ["block", "liner 1", "rod 1", "liner 1", "block"]

# %%
# The same in perspective: every material absorbs the same share per metre.

size = [int(number) for number in sys.argv[1].split("x")] if len(sys.argv) > 1 else (320, 240)
samples = int(sys.argv[2]) if len(sys.argv) > 2 else 4
camera = rs.Camera((-0.2, 0.42, 1.5), (0.0, 0.27, 0.0), fov=25.0)
solid = {"absorption": 20.0, "nested": "inner"}
rs.render(tracer, "xray", size, samples=samples, camera=camera, **solid).save("engine.png")
print(f"wrote engine.png: {scene.triangle_count:,} triangles, {samples} samples")
