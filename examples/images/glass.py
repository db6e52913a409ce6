"""
Light through panes
===================

Some triangles let part of the light through. A filter hides the panes from the camera's rays; a
program at every hit between the floor and the lamp dims the light at each pane, and stops at the
first opaque triangle. In the output, denser characters stand for more light.
"""

import numpy as np

import raystream as rs

PANES = 3
PASSES = 0.8  # of the light, through each pane


def is_solid(hit):
    """A filter: hits on panes do not exist."""
    return hit.mesh_id >= PANES


def dim(hit, light):
    """Some light is left after a pane, none after anything else."""
    if hit.mesh_id >= PANES:
        light[0] = 0.0
        return rs.Decision.STOP
    light[0] *= PASSES
    return rs.Decision.CONTINUE


def square(z, low, high):
    """A square at a height."""
    corners = [[low, low, z], [high, low, z], [high, high, z], [low, high, z]]
    return rs.Mesh(np.array(corners, float), [[0, 1, 2], [0, 2, 3]])


# Panes of growing size over each other, a block above a part of them, and a floor below.
panes = [square(1.0 + k, -1.0 - k, 1.0 + k) for k in range(PANES)]
block, floor = square(5.0, 1.0, 4.0), square(0.0, -4.0, 4.0)
tracer = rs.Tracer(rs.Scene([*panes, block, floor]))

x, y = np.meshgrid(np.linspace(-3.5, 3.5, 36), np.linspace(-3.5, 3.5, 18))
eyes = np.stack([x, y, np.full_like(x, 4.5)], axis=-1)
hits = tracer.first_hit(eyes, [0.0, 0.0, -1.0], on_hit=is_solid)
assert (hits.t == 4.5).all()  # the floor

light = np.ones(x.shape)
up = [0.0, 0.0, 1.0]
tracer.trace(hits.positions, up, on_hit=dim, payload=light, t_max=10.0, t_min=0.5)

for row in light[::-1]:
    print("".join(" .:-=+*#%@"[round(9 * value)] for value in row))
print(f"light on the floor: {light.mean():.3f}")

panes_above = sum((np.maximum(abs(x), abs(y)) <= 1 + k).astype(int) for k in range(PANES))
in_shadow = (x >= 1.0) & (y >= 1.0)
assert np.allclose(light, np.where(in_shadow, 0.0, PASSES**panes_above))
