"""
Terrain from distances, in PyTorch
==================================

A scanner measured distances to a terrain: gradients of the distances move the vertices of a model.
"""

import numpy as np

import raystream as rs

try:
    import torch

    from raystream.torch import TorchTracer
except ModuleNotFoundError as error:
    print(f"{error}: pip install raystream[torch]")
    torch = None

SIZE = 12


def grid(heights):
    """Vertices of a terrain of these heights, (SIZE * SIZE, 3)."""
    y, x = np.mgrid[:SIZE, :SIZE].astype(float)
    return np.stack([x, y, heights], axis=-1).reshape(-1, 3)


def main():
    """Start with a plane, and follow the gradients of its heights."""
    corner = (np.arange(SIZE - 1)[:, None] * SIZE + np.arange(SIZE - 1)).reshape(-1, 1)
    faces = (corner + np.array([0, 1, SIZE + 1, 0, SIZE + 1, SIZE])).reshape(-1, 3)

    # A scanner measures distances to the real terrain from two places above it.
    y, x = np.mgrid[:SIZE, :SIZE] / SIZE
    real = grid(np.sin(5 * x) * np.cos(4 * y))
    targets = np.random.default_rng(0).uniform(0.2, SIZE - 1.2, (2, 800, 3)) * [1, 1, 0]
    origins = np.array([[[2.0, 3.0, 9.0]], [[9.0, 8.0, 9.0]]])
    rays = origins, targets - origins
    measured = torch.from_numpy(
        rs.Tracer(rs.Scene.from_arrays(real, faces)).first_hit(*rays).t.astype(float)
    )

    # The model begins flat. Only heights change; rays are traced against the moved model.
    heights = torch.zeros(SIZE * SIZE, dtype=torch.float64, requires_grad=True)
    plane = torch.from_numpy(grid(np.zeros((SIZE, SIZE))))
    up = torch.tensor([0.0, 0.0, 1.0])
    tracer = TorchTracer(rs.Tracer(rs.Scene.from_arrays(plane.numpy(), faces)))
    rays = [torch.from_numpy(one) for one in rays]
    optimizer = torch.optim.Adam([heights], lr=0.05)
    for step in range(151):
        vertices = plane + heights[:, None] * up
        tracer.tracer.update(vertices.detach())
        hits = tracer.first_hit(*rays, vertices=vertices)
        seen = (hits.prim_id >= 0) & torch.isfinite(measured)
        loss = (hits.t - measured)[seen].square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        if step % 30 == 0:
            error = heights.detach().numpy() - real[:, 2]
            print(f"step {step:3d}: RMS error of the heights {np.sqrt(np.mean(error**2)):.3f}")
    assert np.sqrt(np.mean(error**2)) < 0.1


if torch:
    main()
