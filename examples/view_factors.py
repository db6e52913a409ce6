"""Radiative heat exchange: temperatures in an oven whose floor is heated.

View factors between the six walls of a closed oven and a workpiece in it give an energy balance:
each surface radiates, reflects the rest of what it receives, and what the insulated ones lose they
get back. The power that the floor gives is the power that the workpiece takes.
"""

import numpy as np

import raystream as rs

STEFAN_BOLTZMANN = 5.670374e-8  # W / (m^2 K^4)

# Boxes in metres: the oven's walls face inward, the workpiece outward.
corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
box = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
oven = rs.Mesh(corners * [2.0, 1.5, 1.0], box[:, ::-1], name="oven")
part = rs.Mesh(corners * [0.5, 0.4, 0.3] + [0.7, 0.5, 0.4], box, name="workpiece")
scene = rs.Scene([oven, part], up=(0, 0, 1))

# Patches: the walls x = 0, x = 2, y = 0, y = 1.5, floor and ceiling, and the workpiece.
FLOOR, PART = 4, 6
patches = np.concatenate([np.arange(12) // 2, np.full(12, PART)])
found = rs.view_factors(scene, patches, target_error=5e-4, reciprocity=True)
print(f"rays: {found.ray_counts.sum():,}; standard errors up to {found.standard_errors.max():.4f}")
assert np.allclose(found.factors.sum(axis=1), 1.0)
assert found.standard_errors.max() <= 5e-4

# Radiosity: B = emitted + reflectance * F @ B. The floor and the workpiece have temperatures,
# the walls are insulated: they send out all that they receive, B = F @ B.
emissivity = np.full(7, 0.6)
kelvin = np.array([0, 0, 0, 0, 900.0, 0, 400.0])
is_fixed = kelvin > 0
reflectance = np.where(is_fixed, 1 - emissivity, 1.0)
emitted = np.where(is_fixed, emissivity * STEFAN_BOLTZMANN * kelvin**4, 0.0)
radiosity = np.linalg.solve(np.eye(7) - reflectance[:, None] * found.factors, emitted)
power = found.areas * (radiosity - found.factors @ radiosity)
print(f"the floor gives {power[FLOOR]:,.0f} W, the workpiece takes {-power[PART]:,.0f} W")
walls = (radiosity[:4] / STEFAN_BOLTZMANN) ** 0.25
print("walls: " + ", ".join(f"{one:.0f} K" for one in walls))
assert abs(power.sum()) < 1e-6 * power[FLOOR]  # reciprocity keeps the energy
assert ((walls > 400) & (walls < 900)).all()
