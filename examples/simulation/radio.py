"""
Radio coverage
==============

The path loss between a mast and 160,000 receivers around it, with diffraction over the terrain.

Where terrain blocks the line of sight, the edge that obstructs it most diffracts the wave. Rays
find by how much a receiver would have to be raised to see the mast, and the edge that the raised
ray touches. The loss is that of a single knife edge (Recommendation ITU-R P.526, section 4.1); in
line of sight it is that of free space. The check is a wall on a plain, whose edge is known.
In the image, yellow is a loss of 82 dB or less and dark 132 dB or more; the mast is white.
"""

import numpy as np

import raystream as rs

WAVELENGTH = 0.75  # metres: 400 MHz
EARTH = 4 / 3 * 6.371e6  # radius that makes up for the refraction of air
HIGHEST = 1000.0  # by which receivers are raised at most


def parameter_of_edge(tracer, mast, receivers):
    """Diffraction parameter v of the edge between a mast and receivers; -inf in sight."""
    low, high = np.zeros(len(receivers)), np.full(len(receivers), HIGHEST)
    up = np.array([0.0, 0.0, 1.0])
    is_hidden = tracer.any_hit(mast, receivers - mast, t_max=1.0)
    for _ in range(18):
        middle = (low + high) / 2
        blocked = tracer.any_hit(mast, receivers + middle[:, None] * up - mast, t_max=1.0)
        low, high = np.where(blocked, middle, low), np.where(blocked, high, middle)
    # The last ray that is blocked ends at the edge; there the line to the receiver is lower.
    touching = tracer.first_hit(mast, receivers + low[:, None] * up - mast)
    share = np.where(is_hidden, touching.t, 0.5)
    length = np.linalg.norm(receivers - mast, axis=1)
    first, second = share * length, (1 - share) * length
    v = share * low * np.sqrt(2 * length / (WAVELENGTH * first * second))
    return np.where(is_hidden, v, -np.inf)


def loss(tracer, mast, receivers):
    """Loss in decibels: of free space, and of the edge."""
    v = parameter_of_edge(tracer, mast, receivers)
    free = 20 * np.log10(4 * np.pi * np.linalg.norm(receivers - mast, axis=1) / WAVELENGTH)
    x = np.maximum(v, -0.7) - 0.1
    return free + np.where(v > -0.7, 6.9 + 20 * np.log10(np.hypot(x, 1) + x), 0.0)


# A wall of 60 m at x = 3 km on a plain; the mast at x = 0 is 30 m high, receivers 2 m.
plain = [[-100, -9000, 0], [9000, -9000, 0], [9000, 9000, 0], [-100, 9000, 0]]
wall = [[3000, -9000, 0], [3000, 9000, 0], [3000, 9000, 60], [3000, -9000, 60]]
quad = [[0, 1, 2], [0, 2, 3]]
tracer = rs.Tracer(rs.Scene([rs.Mesh(plain, quad), rs.Mesh(wall, quad)], up=(0, 0, 1)))
x = np.linspace(3100, 8000, 50)
receivers = np.stack([x, np.zeros_like(x), np.full_like(x, 2.0)], axis=-1)
found = parameter_of_edge(tracer, np.array([0.0, 0.0, 30.0]), receivers)
above = 60 - (30 + (2 - 30) * 3000 / x)
expected = above * np.sqrt(2 / WAVELENGTH * (1 / 3000 + 1 / (x - 3000)))
error = np.abs(found / expected - 1).max()
print(f"edge of the wall: v is {found.min():.2f} to {found.max():.2f}, relative error {error:.0e}")
assert error < 2e-3

# Hills, lowered by the curvature of the Earth as seen from the mast.
side = 25.0 * np.arange(400)
x, y = np.meshgrid(side, side)
heights = 110 * np.sin(x / 710) * np.cos(y / 930) + 60 * np.sin((x + 2 * y) / 570)
heights += 300 * np.exp(-(((x - 6200) / 900) ** 2) - ((y - 5600) / 700) ** 2)
place = np.array([170, 190])  # column and row
mast = np.append(25.0 * place, heights[place[1], place[0]] + 40.0)
ground = heights - ((x - mast[0]) ** 2 + (y - mast[1]) ** 2) / (2 * EARTH)
tracer = rs.Tracer(rs.Scene.height_field(ground, spacing=25.0))
receivers = np.stack([x, y, ground + 2.0], axis=-1).reshape(-1, 3)
decibels = loss(tracer, mast, receivers).reshape(x.shape)
print(f"{decibels.size:,} receivers: {decibels.min():.0f} to {decibels.max():.0f} dB")

share = np.clip((132 - decibels[..., None]) / 50, 0, 1)
slope = 0.6 + 0.4 * np.clip(np.gradient(heights, axis=1)[..., None] / 10, -1, 1)
image = slope * ((1 - share) * [0.02, 0.02, 0.1] + share * [0.9, 0.7, 0.1])
image[place[1] - 3 : place[1] + 4, place[0] - 3 : place[0] + 4] = 1.0
rs.Image(image[::-1]).save("radio.png")  # north is up
print("wrote radio.png")
