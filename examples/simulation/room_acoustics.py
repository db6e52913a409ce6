"""
Room acoustics
==============

The echoes of a clap in a room with a screen, by image sources and visibility.

Mirroring the source in the walls of a room gives its images. A straight line from an image to the
listener, folded back into the room, is the path of an echo (Allen and Berkley, "Image Method for
Efficiently Simulating Small-Room Acoustics", Journal of the Acoustical Society of America 65(4),
1979). Rays find which paths the screen blocks; these are pale in the image, which shows
100 ms from left to right and 60 dB from bottom to top.
"""

import itertools

import numpy as np

import raystream as rs

ROOM = np.array([8.0, 5.0, 3.0])  # metres
SOURCE, EAR = np.array([1.5, 2.0, 1.2]), np.array([6.5, 3.0, 1.6])
ORDER, REFLECTANCE, SOUND = 12, 0.8, 343.0  # reflections; pressure kept by each; m/s

# Images by their cell of the lattice of mirrored rooms; the source's room is cell 0.
cells = np.array(list(itertools.product(range(-ORDER, ORDER + 1), repeat=3)))
cells = cells[np.abs(cells).sum(axis=1) <= ORDER]
images = cells * ROOM + np.where(cells % 2 == 0, SOURCE, ROOM - SOURCE)

# Each path crosses as many planes of the lattice as it has reflections. Between crossings it is
# straight in the room, too.
paths, shares = [], []
for number, (cell, image) in enumerate(zip(cells, images, strict=True)):
    crossed = [0.0, 1.0]
    for axis, count in enumerate(cell):
        planes = ROOM[axis] * (np.arange(1, count + 1) if count > 0 else np.arange(count + 1, 1))
        crossed += ((planes - EAR[axis]) / (image[axis] - EAR[axis])).tolist()
    shares.append(np.sort(crossed))
    paths.append(np.full(len(crossed) - 1, number))
paths = np.concatenate(paths)
starts = np.concatenate([one[:-1] for one in shares])
ends = np.concatenate([one[1:] for one in shares])


def folded(share):
    """Points of the paths at a share of their length, in the room."""
    place = EAR + share[:, None] * (images - EAR)[paths]
    return np.abs((place + ROOM) % (2 * ROOM) - ROOM)


# The screen reaches from one wall past the middle, and not to the ceiling.
screen = rs.Mesh([[4, 0, 0], [4, 3.2, 0], [4, 3.2, 2.2], [4, 0, 2.2]], [[0, 1, 2], [0, 2, 3]])
tracer = rs.Tracer(rs.Scene([screen], up=(0, 0, 1)))
origins = folded(starts)
is_blocked = tracer.any_hit(origins, folded(ends) - origins, t_max=1.0)
is_heard = np.bincount(paths, is_blocked) == 0

lengths = np.linalg.norm(images - EAR, axis=1)
delays = 1e3 * lengths / SOUND
pressures = REFLECTANCE ** np.abs(cells).sum(axis=1) / lengths
print(
    f"{len(images):,} paths of {len(paths):,} straight parts; the screen leaves {is_heard.sum():,}"
)
folded_lengths = np.bincount(paths, np.linalg.norm(folded(ends) - origins, axis=1))
assert np.allclose(folded_lengths, lengths)
direct = np.flatnonzero(~cells.any(axis=1))[0]
assert not is_heard[direct]
print(
    f"direct sound, {delays[direct]:.1f} ms: blocked; first echo: {delays[is_heard].min():.1f} ms"
)

# The echoes as an image: time to the right, 100 ms wide; 60 dB high; blocked ones are pale.
width, height = 800, 300
image = np.ones((height, width, 3))
loudness = 20 * np.log10(pressures / pressures.max())
for number in np.argsort(is_heard, kind="stable"):
    column, row = int(width * delays[number] / 100), int(-height * loudness[number] / 60)
    if column < width and row < height:
        image[row:, column] = [0.05, 0.2, 0.5] if is_heard[number] else [0.75, 0.55, 0.5]
rs.Image(image).save("room_acoustics.png")
print("wrote room_acoustics.png")
