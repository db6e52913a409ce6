"""
Rasterised, with traced shadows
===============================

The graphics pipeline finds the visible surfaces, and rays find the shadows (Purcell 2002).
"""

import raystream as rs
from raystream.graphics import hybrid
from raystream.graphics.errors import GraphicsError

scene = rs.load("cornell")
try:
    image = hybrid(scene, (320, 320))
except GraphicsError as error:  # no adapter, or wgpu is not installed
    print(error)
else:
    image.save("hybrid.png")
    seen = image.layers["prim_id"]
    print(f"hybrid.png: {(seen >= 0).sum():,} pixels were rasterised, and lit by ray tracing")
