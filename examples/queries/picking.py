"""
Picking in a notebook
=====================

Click on an image to list everything behind that pixel: all hits of its ray, sorted by distance.

In a notebook, ``pip install ipympl`` and ``%matplotlib widget`` make the figure interactive. Here
one click is sent to it by the program.
"""

import raystream as rs

scene = rs.load("robots")
tracer = rs.Tracer(scene)
width, height = 480, 320
origins, directions = scene.camera.rays(width, height)


# %%
# A pixel's ray is at its row and column. Objects behind or inside others are hits as well.


def pick(column, row):
    """List the hits of a pixel's ray: distance, part and material."""
    hits = tracer.multi_hit(origins[row, column], directions[row, column])
    names = [scene.meshes[k].name for k in hits.mesh_id]
    materials = [scene.materials[k].name for k in hits.material_id]
    return list(zip(hits.t.tolist(), names, materials, strict=True))


for t, part, material in pick(100, 180):
    print(f"{t:7.3f} m  {part:7} {material}")
assert pick(300, 0) == []  # the sky

# %%
# The figure: an image, and a text that each click replaces.

try:
    import matplotlib as mpl
except ModuleNotFoundError:
    print("no plot: pip install raystream[plot]")
else:
    mpl.use("Agg")  # in a notebook, leave this line out
    from matplotlib import pyplot as plt
    from matplotlib.backend_bases import MouseEvent

    image = rs.render(tracer, mode="whitted", size=(width, height), samples=2)
    figure, (view, table) = plt.subplots(
        2, 1, figsize=(6.4, 7.6), height_ratios=[3, 2], layout="constrained"
    )
    view.imshow(image.to_bytes())
    view.set_axis_off()
    table.set_axis_off()
    (cross,) = view.plot([], [], "+", color="red", ms=16)
    text = table.text(0, 1, "Click on the image", va="top", family="monospace", fontsize=10)

    def clicked(event):
        """Show the hits of the pixel below the mouse."""
        if event.inaxes is view:
            column, row = int(event.xdata + 0.5), int(event.ydata + 0.5)
            cross.set_data([column], [row])
            lines = [f"{t:7.3f} m  {material}" for t, _, material in pick(column, row)]
            pairs = zip(lines[:10], [*lines[10:20], *[""] * 10], strict=False)
            text.set_text("\n".join(f"{a:28}{b}" for a, b in pairs) or "nothing")
            figure.canvas.draw_idle()

    figure.canvas.mpl_connect("button_press_event", clicked)

    figure.canvas.draw()
    x, y = view.transData.transform((100, 180))
    figure.canvas.callbacks.process(
        "button_press_event", MouseEvent("button_press_event", figure.canvas, x, y, 1)
    )
    assert "metal" in text.get_text()
    figure.savefig("picking.png", dpi=80)
    print("wrote picking.png")
