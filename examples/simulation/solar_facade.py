"""
Hours of sun on a façade
========================

How long does the sun shine on each part of a wall that faces south, across the street from two
buildings?

For every five minutes of a day in February at 48 degrees north, rays are cast from the points of
the wall toward the sun. The check is the shadow of an endless building, which has a closed form;
the image has two buildings with a gap between them, and
brighter parts have more hours of sun.
"""

import numpy as np

import raystream as rs

LATITUDE, DECLINATION = np.radians(48.0), np.radians(-15.0)
STEP = 5 / 60  # hours
STREET, HEIGHT = 12.0, 15.0  # width, and height of the buildings in front, in metres

QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
BOX = np.array([t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))])


def building(west, east, height):
    """A box across the street; x is east, y north, z up."""
    ends = ((west, east), (-STREET - 10.0, -STREET), (0.0, height))
    return rs.Mesh(np.stack(np.meshgrid(*ends, indexing="ij"), axis=-1).reshape(8, 3), BOX)


# The façade: points of a wall of 40 x 24 m.
x, z = np.meshgrid(np.linspace(-20, 20, 320), np.linspace(24, 0.05, 192))
points = np.stack([x, np.zeros_like(x), z], axis=-1)

# Directions to the sun while it is up, by the angle that the Earth has turned since noon.
angle = np.radians(15.0 * (np.arange(STEP / 2, 24, STEP) - 12.0))
up = np.sin(LATITUDE) * np.sin(DECLINATION)
up = up + np.cos(LATITUDE) * np.cos(DECLINATION) * np.cos(angle)
south = np.sin(LATITUDE) * np.cos(DECLINATION) * np.cos(angle)
south = south - np.cos(LATITUDE) * np.sin(DECLINATION)
sun = np.stack([-np.cos(DECLINATION) * np.sin(angle), -south, up], axis=-1)
assert np.allclose(np.linalg.norm(sun, axis=-1), 1.0)
is_day = (up > 0) & (south > 0)


def solar_hours(*buildings):
    """Hours of sun at the points of the façade."""
    tracer = rs.Tracer(rs.Scene(buildings, up=(0, 0, 1)))
    hours = np.zeros(x.shape)
    for direction in sun[is_day]:
        hours += STEP * ~tracer.any_hit(points, direction)
    return hours


# The sun's elevation seen along the street decides; 100 m is endless for this façade.
hours = solar_hours(building(-100.0, 100.0, HEIGHT))
is_above = z[..., None] + STREET * (up / south)[is_day] > HEIGHT
difference = np.abs(hours - STEP * is_above.sum(axis=-1)).max()
print(
    f"endless building: {hours.min():.1f} to {hours.max():.1f} hours, error {difference:.0e} hours"
)
assert difference < 1e-9

hours = solar_hours(building(-60.0, -4.0, HEIGHT), building(3.0, 60.0, 1.4 * HEIGHT))
print(f"with a gap: {hours.min():.1f} to {hours.max():.1f} hours of sun")
share = (hours[..., None] / (STEP * is_day.sum())) ** 2
image = (1 - share) * [0.01, 0.015, 0.09] + share * [1.0, 0.6, 0.08]
rs.Image(np.repeat(np.repeat(image, 2, axis=0), 2, axis=1)).save("solar_facade.png")
print("wrote solar_facade.png")
