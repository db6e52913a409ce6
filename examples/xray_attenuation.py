"""X-ray attenuation: what a detector sees of an assembly of several materials.

Parallel rays cross a valve-like assembly of closed parts; Beer and Lambert's law gives the
fraction that passes. Two parts have chords that are known exactly, and are checked.
"""

import numpy as np

import raystream as rs
from raystream.scene.procedural.parts import instance, merge, to_mesh
from raystream.scene.procedural.shapes import box, cylinder, sphere

# In centimetres; attenuation per centimetre at about 100 keV.
MATERIALS = {"aluminium": 0.46, "steel": 2.9, "polymer": 0.18}
STEEL, POLYMER = 1, 2


def placed(part, size, offset, material=0):
    """Scale, move and paint a part."""
    return instance(part, [np.diag(size)], [offset]).painted(material)


# A housing is a box with a bore: the bore faces inward, so the mesh is hollow there. The
# ball within it, the parts beside it and the bolts in front are solids of their own.
bore = placed(cylinder(96), (1.2, 2.0, 1.2), (0.0, -1.0, 0.0)).flipped()
housing = merge([placed(box(), (2.0, 1.5, 1.6), (0.0, 0.0, 0.0)), bore])
ball = placed(sphere(48), (0.9, 0.9, 0.9), (0.0, 0.0, 0.0), STEEL)
plate = placed(box(), (0.9, 0.1, 1.6), (3.4, 0.6, 0.0), STEEL)
block = placed(box(), (0.9, 0.7, 1.0), (3.4, -0.5, 0.0), POLYMER)
bolts = [placed(cylinder(32), (0.2, 3.2, 0.2), (x, -1.6, 1.9), STEEL) for x in (-1.6, 1.6)]
parts = {"housing": housing, "ball": ball, "plate": plate, "block": block, "bolts": merge(bolts)}
scene = rs.Scene(
    [to_mesh(part, name) for name, part in parts.items()],
    materials=[rs.Material(name) for name in MATERIALS],
)

# A detector of 480 x 320 pixels behind the assembly, and parallel rays along z.
x, y = np.meshgrid(np.linspace(-2.6, 4.8, 480), np.linspace(2.4, -2.4, 320))
origins = np.stack([x, y, np.full_like(x, 6.0)], axis=-1)
found = rs.thickness(rs.Tracer(scene), origins, [0.0, 0.0, -1.0])
image = rs.attenuation(found, MATERIALS)
lengths = found.total_length(by="mesh")
print(f"{found.is_complete.mean():.2%} of {found.is_complete.size:,} rays are complete")
print(f"transmitted: {image.min():.4f} to {image.max():.4f}")

# The ball's chord is 2 sqrt(r^2 - d^2), the plate's is its depth.
radius = np.hypot(x, y)
inner = radius < 0.8
chord = 2 * np.sqrt(0.81 - radius[inner] ** 2)
ball_error = np.abs(lengths[..., 1][inner] - chord).max()
on_plate = (np.abs(x - 3.4) < 0.89) & (np.abs(y - 0.6) < 0.09)
plate_error = np.abs(lengths[..., 2][on_plate] - 3.2).max()
print(f"largest error: ball {ball_error:.4f} cm (it has facets), plate {plate_error:.1e} cm")
assert found.is_complete.all()
assert ball_error < 0.01
assert plate_error < 1e-5
passed = np.exp(-MATERIALS["steel"] * 3.2)
assert np.allclose(image[on_plate], passed, rtol=1e-4)

try:
    import matplotlib as mpl
except ModuleNotFoundError:
    print("no picture: pip install raystream[plot]")
else:
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(2, 1, figsize=(6.4, 7.2), layout="constrained")
    frame = [x.min(), x.max(), y.min(), y.max()]
    shown = axes[0].imshow(image, cmap="gray", extent=frame, vmin=0, vmax=1)
    figure.colorbar(shown, label="transmitted fraction")
    shown = axes[1].imshow(lengths.sum(axis=-1), cmap="magma", extent=frame)
    figure.colorbar(shown, label="path in solids, cm")
    for axis, title in zip(axes, ("X-ray attenuation", "Thickness"), strict=True):
        axis.set(title=title, xlabel="x, cm", ylabel="y, cm")
    figure.savefig("xray.png", dpi=80)
    print("wrote xray.png")
