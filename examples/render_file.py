"""Render a file: from a model to a picture.

    python examples/render_file.py model.obj picture.png

Without arguments it writes a small model of its own first.
"""

import sys
from pathlib import Path

import raystream as rs

PYRAMID = """\
v -1 0 -1
v  1 0 -1
v  1 0  1
v -1 0  1
v  0 1.4 0
f 4 3 2 1
f 1 2 5
f 2 3 5
f 3 4 5
f 4 1 5
"""

if len(sys.argv) == 3:
    model, picture = Path(sys.argv[1]), Path(sys.argv[2])
else:
    model, picture = Path("pyramid.obj"), Path("pyramid.png")
    model.write_text(PYRAMID)

scene = rs.load(model)
image = rs.render(scene, mode="raycast", size=(640, 480), samples=4)
image.save(picture)
print(f"{picture}: {scene.triangle_count:,} triangles, {image.size[0]}x{image.size[1]} pixels")
