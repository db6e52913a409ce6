"""
Render a file
=============

From a model file to an image.

.. code-block:: console

    $ python examples/images/render_file.py model.obj image.png

Without arguments it writes a small model first.
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
    model, target = Path(sys.argv[1]), Path(sys.argv[2])
else:
    model, target = Path("pyramid.obj"), Path("pyramid.png")
    model.write_text(PYRAMID)

scene = rs.load(model)
image = rs.render(scene, mode="raycast", size=(640, 480), samples=4)
image.save(target)
print(f"{target}: {scene.triangle_count:,} triangles, {image.size[0]}x{image.size[1]} pixels")
