"""
LiDAR from a drone
==================

Laser pulses from above a forest, with several returns each: leaves let part of the light through.
"""

import numpy as np

import raystream as rs

scene = rs.load("forest", triangles=200_000)
low, high = scene.bounds
tracer = rs.Tracer(scene)

# A drone flies along z at 60 m and swings its beam across: 400 lines of 300 pulses.
line, swing = np.meshgrid(np.linspace(-14, 14, 400), np.radians(np.linspace(-14, 14, 300)))
origins = np.stack([np.zeros_like(line), np.full_like(line, 60.0), line], axis=-1)
directions = np.stack([np.sin(swing), -np.cos(swing), np.zeros_like(swing)], axis=-1)

# A beam of 0.5 mrad, in seven rays. Leaves fill half of their outlines.
found = rs.lidar_returns(
    tracer,
    origins,
    directions,
    reflectance={"ground": 0.3, "bark": 0.4, "leaf": 0.6},
    transmission={"leaf": 0.5},
    divergence=np.degrees(0.5e-3),
    sub_rays=7,
    separation=0.3,
)
numbers = np.bincount(found.return_number)[1:]
print(f"{len(found.ranges):,} returns of {found.counts.size:,} pulses")
print("by number:", "  ".join(f"{i + 1}: {n:,}" for i, n in enumerate(numbers)))
for material_id, name in enumerate(material.name for material in scene.materials):
    own = found.material_id == material_id
    print(f"{name}: {own.mean():.1%}, mean intensity {found.intensity[own].mean():.2f}")
assert (np.diff(numbers) <= 0).all()
assert found.return_count.max() <= 5
last = found.return_number == found.return_count
assert (found.material_id[last] == 0).mean() > (found.material_id[~last] == 0).mean()

try:
    import matplotlib as mpl
except ModuleNotFoundError:
    print("no plot: pip install raystream[plot]")
else:
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(2, 1, figsize=(7.2, 7.6), layout="constrained")
    colors = plt.get_cmap("viridis_r", 5)
    slab = np.abs(found.positions[:, 2]) < 3.0
    x, y = found.positions[slab, :2].T
    style = {"cmap": colors, "vmin": 0.5, "vmax": 5.5}
    shown = axes[0].scatter(x, y, c=found.return_number[slab], s=2, **style)
    axes[0].set(title="Return number: a slice, 6 m deep", xlabel="x, m", ylabel="height, m")
    axes[0].set_aspect("equal")
    axes[1].pcolormesh(line, np.degrees(swing), found.counts, **style)
    axes[1].set(title="Returns of each pulse", xlabel="z, m", ylabel="swing, degrees")
    figure.colorbar(
        shown, ax=axes, label="return number, or number of returns", ticks=range(1, 6), shrink=0.6
    )
    figure.savefig("lidar.png", dpi=80)
    print("wrote lidar.png")
