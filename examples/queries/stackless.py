"""
Traversal without a stack
=========================

How a ray traverses a kd-tree with a stack, by restarting at the root, and by backtracking to an
ancestor, as in Figures 3 and 4 of Foley and Sugerman, "KD-Tree Acceleration Structures for a GPU
Raytracer", Graphics Hardware 2005.

The image shows the leaves that the ray visits, and the depth in the tree after each run of a
kernel. All three visit the same leaves in the same order; they differ in how they find the next.
"""

import numpy as np

import raystream as rs
from raystream.stepper import walk

# Pillars on a plan of 20 x 12 m, and a ray between them until it hits one.
rng = np.random.default_rng(4)
corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
places = np.array([[x, y] for x in range(1, 20, 2) for y in range(1, 12, 2)], float)
places += rng.uniform(-0.6, 0.6, places.shape)
pillars = [rs.Mesh(corners * [0.5, 0.5, 1] + [x, y, 0], faces) for x, y in places]
scene = rs.Scene(pillars, up=(0, 0, 1))
origin, direction = np.array([0.2, 0.9, 0.5]), np.array([1.0, 0.5, 0.0])

TRAVERSALS = ("stack", "restart", "backtrack")
walks, orders = {}, []
for traversal in TRAVERSALS:
    way = walk(rs.Tracer(scene, "kdtree", traversal=traversal), origin, direction)
    walks[traversal] = [step.at for step in way.steps if step.at is not None]
    leaves = [spot.number for spot in walks[traversal] if spot.kind == "leaf"]
    orders.append(list(dict.fromkeys(leaves)))
    print(
        f"{traversal:9}  {len(orders[-1])} leaves, {way.counts['steps']:3} steps,"
        f" {way.counts['restarts']} restarts, {way.counts['backtracks']} backtracks"
    )
assert orders[0] == orders[1] == orders[2]

# The depth of a node: the number of split nodes whose boxes contain its box.
visited = {spot.number: spot for name in TRAVERSALS for spot in walks[name]}
splits = [spot for spot in visited.values() if spot.kind == "split"]
ROUNDING = 1e-6  # metres
depths = {
    number: sum(
        all(a <= b + ROUNDING for a, b in zip(other.low, spot.low, strict=True))
        and all(a >= b - ROUNDING for a, b in zip(other.high, spot.high, strict=True))
        for other in splits
        if other.number != number
    )
    for number, spot in visited.items()
}

try:
    import matplotlib as mpl
except ModuleNotFoundError:
    print("no plot: pip install raystream[plot]")
else:
    mpl.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.patches import Rectangle

    figure, axes = plt.subplots(
        4, 1, figsize=(7.2, 9), layout="constrained", height_ratios=[3, 1, 1, 1]
    )
    for rank, number in enumerate(orders[0]):
        low, high = np.array(visited[number].low[:2]), np.array(visited[number].high[:2])
        shade = plt.get_cmap("YlGnBu")(0.15 + 0.6 * rank / len(orders[0]))
        axes[0].add_patch(Rectangle(low, *(high - low), fc=shade, ec="tab:blue"))
    for place in places:
        axes[0].add_patch(Rectangle(place, 0.5, 0.5, fc="0.4"))
    end = origin + way.t * direction
    axes[0].annotate("", end[:2], origin[:2], arrowprops={"arrowstyle": "->", "color": "tab:red"})
    axes[0].set(xlim=(0, 20.5), ylim=(0, 12.5), aspect="equal", title="leaves, in order")
    most = max(len(walks[name]) for name in TRAVERSALS)
    for axis, name in zip(axes[1:], TRAVERSALS, strict=True):
        depth = [depths[spot.number] for spot in walks[name]]
        axis.plot(depth, color="0.6", lw=1)
        is_leaf = [k for k, spot in enumerate(walks[name]) if spot.kind == "leaf"]
        axis.plot(is_leaf, [depth[k] for k in is_leaf], "o", ms=3, color="tab:blue")
        axis.set(title=name, ylabel="depth", xlim=(-1, most))
        axis.invert_yaxis()
    axes[-1].set(xlabel="runs of kernels; leaves are marked")
    figure.savefig("stackless.png", dpi=80)
    print("wrote stackless.png")
