"""
Position of a sensor, in JAX
============================

Where is the sensor? Its position is found from a few measured distances by Gauss-Newton
steps; the first one may overshoot.
"""

import numpy as np

import raystream as rs

try:
    import jax
    import jax.numpy as jnp

    from raystream.jax import JaxTracer
except ModuleNotFoundError as error:
    print(f"{error}: pip install raystream[jax]")
    jax = None


def main():
    """Start near the sensor, and follow the slopes of its distances."""
    tracer = JaxTracer(rs.Tracer(rs.load("cornell")))

    # A sensor in the box measures distances to the walls and the ceiling, above the two blocks, in
    # 24 directions, in millimetres.
    angles = np.linspace(-1.2, 1.2, 24)
    heights = 0.35 + 0.3 * np.cos(7 * angles)
    directions = np.stack([np.sin(angles), heights, np.cos(angles)], axis=1)
    directions = jnp.asarray(directions / np.linalg.norm(directions, axis=1, keepdims=True))
    place = jnp.array([250.0, 330.0, 60.0])
    noise = 0.5 * np.random.default_rng(0).normal(size=len(angles))
    measured = tracer.first_hit(place, directions).t + noise

    @jax.jit
    def step(guess):
        def residual(origin):
            hits = tracer.first_hit(origin, directions)
            # A miss has no distance and no slope: it counts as 0.
            return jnp.where(hits.prim_id >= 0, hits.t - measured, 0.0)

        slopes = jax.jacfwd(residual)(guess)
        change, *_ = jnp.linalg.lstsq(slopes, residual(guess))
        return guess - change

    guess = jnp.array([280.0, 300.0, 100.0])
    print(f"first guess: {float(jnp.linalg.norm(guess - place)):.1f} mm off")
    for number in range(6):
        guess = step(guess)
        print(f"step {number + 1}: {float(jnp.linalg.norm(guess - place)):.2f} mm off")
    assert float(jnp.linalg.norm(guess - place)) < 2.0


if jax:
    main()
