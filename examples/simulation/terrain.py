"""
Viewshed
========

What a lookout (white) sees of the terrain, drawn in orange, and the ground in evening light with
shadows.
"""

import numpy as np

import raystream as rs

# Synthetic heights in metres; an elevation raster, such as an xarray.DataArray, works alike.
side = 20.0 * np.arange(500)
x, y = np.meshgrid(side, side)
heights = 90 * np.sin(x / 310) * np.cos(y / 430) + 45 * np.sin((x + 2 * y) / 270)
heights += 260 * np.exp(-(((x - 5200) / 900) ** 2) - ((y - 4600) / 500) ** 2)

ground = rs.terrain(heights, spacing=20.0)
visible = ground.viewshed((3000.0, 5000.0), height=15.0, target_height=1.7)
shade = ground.hillshade(azimuth=250.0, altitude=15.0, shadows=True)

light = 0.25 + 0.75 * shade[..., None]
color = np.where(visible[..., None], [0.9, 0.45, 0.1], [0.55, 0.55, 0.55])
image = light * color
image[246:255, 146:155] = 1.0  # the lookout, at 3,000 and 5,000 m
rs.Image(image[::-1]).save("terrain.png")  # north is up
print(f"terrain.png: {ground}")
print(f"{visible.mean():.1%} in sight, {np.mean(shade == 0):.1%} in shadow")
