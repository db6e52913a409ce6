"""Does the cost of a ray depend on what it cannot see?

    python benchmarks/scalability.py -o scalability.png

Rayforce's authors say that performance "depends only on geometric complexity along a ray". Here a
camera looks at a scene in front of a wall; behind the wall, small triangles are added until there
are 100 times as many as in front. Counts the traversal steps and triangle tests of the camera's
rays in each structure, and plots them (with matplotlib). The figures in docs/structures.rst come
from here.
"""

import argparse

import numpy as np

import raystream as rs

STRUCTURES = ("graph", "kdtree", "bvh", "grid")
FACTORS = (0, 1, 3, 10, 30, 100)


def walled_scene(visible, hidden_count, rng):
    """The visible meshes, a wall behind them, and triangles behind the wall."""
    low, high = visible.bounds
    size = high - low
    eye = np.asarray(visible.camera.eye, float)
    axis = int(np.argmax(np.abs(eye - (low + high) / 2)))
    side = -1.0 if eye[axis] > (low + high)[axis] / 2 else 1.0  # away from the eye
    across = [k for k in range(3) if k != axis]
    wall = np.zeros((4, 3))
    wall[:, axis] = (high if side > 0 else low)[axis] + side * 0.01 * size[axis]
    reach = 4.0 * size.max()
    for corner, (a, b) in enumerate([(-1, -1), (1, -1), (1, 1), (-1, 1)]):
        wall[corner, across] = (low + high)[across] / 2 + reach * np.array([a, b])
    bare = [rs.Mesh(mesh.vertices, mesh.faces) for mesh in visible.meshes]
    meshes = [*bare, rs.Mesh(wall, [[0, 1, 2], [0, 2, 3]])]
    if hidden_count:
        place = low + rng.random((hidden_count, 1, 3)) * size
        place[..., axis] += side * 1.1 * size[axis]
        corners = place + 0.004 * size.max() * rng.normal(size=(hidden_count, 3, 3))
        faces = np.arange(3 * hidden_count).reshape(-1, 3)
        meshes.append(rs.Mesh(corners.reshape(-1, 3), faces))
    return rs.Scene(meshes, camera=visible.camera)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("-o", "--output", default="scalability.png")
    parser.add_argument("--scene", default="spheres")
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--structures", nargs="+", default=STRUCTURES)
    arguments = parser.parse_args()
    visible = rs.load(arguments.scene)
    rays = visible.camera_for(1.0).rays(arguments.size, arguments.size)
    found = {name: [] for name in arguments.structures}
    triangle_counts = []
    for factor in FACTORS:
        hidden = factor * len(visible.triangles)
        scene = walled_scene(visible, hidden, np.random.default_rng(1))
        triangle_counts.append(len(scene.triangles))
        for name in arguments.structures:
            tracer = rs.Tracer(scene, name, counters=True)
            tracer.first_hit(*rays)
            total, count = tracer.counters.total, rays[1].size // 3
            steps = total["steps"] + total["link_nodes"]
            found[name].append((steps / count, total["tests"] / count))
            print(
                f"{len(scene.triangles):10,} triangles  {name:8} "
                f"{steps / count:8.2f} steps  {total['tests'] / count:9.2f} tests",
                flush=True,
            )
    plot(arguments.output, triangle_counts, found)


def plot(path, triangle_counts, found):
    """Plot the steps and tests per ray against the number of triangles."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    for k, (panel, title) in enumerate(
        zip(panels, ("steps per ray", "triangle tests per ray"), strict=True)
    ):
        for name, numbers in found.items():
            panel.plot(triangle_counts, [pair[k] for pair in numbers], marker="o", label=name)
        panel.set(xscale="log", yscale="log", xlabel="triangles in the scene", title=title)
        panel.grid(alpha=0.3)
    panels[1].legend()
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
