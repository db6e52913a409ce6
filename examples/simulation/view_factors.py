"""
View factors in an oven
=======================

Temperatures in a closed oven whose floor is heated, by the heat that its surfaces exchange.

View factors between patches of the six walls and a workpiece give an energy balance: each surface
radiates and reflects part of what it receives, and insulated walls give back all of it. The check
is that the power of the floor equals the power that the workpiece absorbs. The image shows the
side walls folded out around the ceiling; hotter is brighter.
"""

import numpy as np

import raystream as rs

STEFAN_BOLTZMANN = 5.670374e-8  # W / (m^2 K^4)
SIZE = np.array([2.0, 1.5, 1.0])  # metres; walls are divided into squares of 25 cm
CELLS = np.array([8, 6, 4])


def divided(axis, at):
    """Squares of the wall where a coordinate has a value, as triangles; they face inward."""
    u, v = [k for k in range(3) if k != axis]
    nodes = np.zeros((CELLS[u] + 1, CELLS[v] + 1, 3))
    nodes[..., axis] = at
    nodes[..., u] = np.linspace(0, SIZE[u], CELLS[u] + 1)[:, None]
    nodes[..., v] = np.linspace(0, SIZE[v], CELLS[v] + 1)
    ids = np.arange(nodes[..., 0].size).reshape(nodes.shape[:2])
    a, b, c, d = ids[:-1, :-1], ids[1:, :-1], ids[1:, 1:], ids[:-1, 1:]
    faces = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    is_inward = (at == 0) == (axis != 1)  # x cross z is -y
    return rs.Mesh(nodes.reshape(-1, 3), faces if is_inward else faces[:, ::-1])


walls = [divided(axis, at) for axis in range(3) for at in (0.0, SIZE[axis])]
corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
box = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
workpiece = rs.Mesh(corners * [0.5, 0.4, 0.3] + [0.7, 0.5, 0.4], box)
scene = rs.Scene([*walls, workpiece], up=(0, 0, 1))

# A patch is a square of a wall, which is two triangles; the workpiece is one patch.
first = np.cumsum([0, *(len(wall.faces) // 2 for wall in walls)])  # patch of each wall
patches = np.concatenate([np.arange(2 * first[-1]) // 2, np.full(len(box), first[-1])])
found = rs.view_factors(scene, patches, target_error=3e-3, reciprocity=True)
print(f"{len(found.areas)} patches, {found.ray_counts.sum():,} rays")
assert np.allclose(found.factors.sum(axis=1), 1.0)

# Radiosity: B = emitted + reflectance * F @ B. The floor and the workpiece have temperatures;
# the other walls are insulated and send out all that they receive, B = F @ B.
FLOOR = slice(first[4], first[5])
kelvin = np.zeros(len(found.areas))
kelvin[FLOOR], kelvin[-1] = 900.0, 400.0
emissivity, is_insulated = 0.6, kelvin == 0
reflectance = np.where(is_insulated, 1.0, 1 - emissivity)
emitted = np.where(is_insulated, 0.0, emissivity * STEFAN_BOLTZMANN * kelvin**4)
system = np.eye(len(kelvin)) - reflectance[:, None] * found.factors
radiosity = np.linalg.solve(system, emitted)
power = found.areas * (radiosity - found.factors @ radiosity)
print(f"the floor gives {power[FLOOR].sum():,.0f} W, the workpiece absorbs {-power[-1]:,.0f} W")
assert abs(power.sum()) < 1e-6 * power[FLOOR].sum()  # reciprocity conserves the energy

temperature = (radiosity / STEFAN_BOLTZMANN) ** 0.25
insulated = temperature[is_insulated]
print(f"insulated walls: {insulated.min():.0f} to {insulated.max():.0f} K")
assert 400 < insulated.min() < insulated.max() < 900

# The ceiling in the middle and the side walls around it, folded outward.
low_x, high_x, low_y, high_y, _, ceiling = (
    temperature[first[k] : first[k + 1]].reshape([CELLS[u] for u in range(3) if u != k // 2])
    for k in range(6)
)
unfolded = np.full((CELLS[1] + 2 * CELLS[2] + 2, CELLS[0] + 2 * CELLS[2] + 2), np.nan)
rows = slice(CELLS[2] + 1, CELLS[2] + 1 + CELLS[1])
columns = slice(CELLS[2] + 1, CELLS[2] + 1 + CELLS[0])
unfolded[rows, columns] = ceiling.T
unfolded[rows, : CELLS[2]], unfolded[rows, -CELLS[2] :] = low_x, high_x[:, ::-1]
unfolded[: CELLS[2], columns], unfolded[-CELLS[2] :, columns] = low_y.T, high_y.T[::-1]
coldest, hottest = np.nanmin(unfolded), np.nanmax(unfolded)
heat = ((unfolded - coldest) / (hottest - coldest)).repeat(24, axis=0).repeat(24, axis=1)
image = np.clip(np.stack([2 * heat, 2 * heat - 0.6, 3 * heat - 2], axis=-1), 0.02, 1)
rs.Image(np.where(np.isnan(heat)[..., None], 0.75, image)).save("view_factors.png")
print("wrote view_factors.png")
