"""
Two workers
===========

Rays and an image, computed by two worker processes of this machine with Dask.
"""

import importlib.util

import raystream as rs


def main():
    """Processes of a cluster import this file: only the first one runs it."""
    import dask.array as da

    scene = rs.load("cornell")
    middle = scene.bounds.mean(axis=0)
    # Elsewhere "tcp://..." of a scheduler, or a distributed.Client.
    with rs.cluster.Tracer(scene, "local:2") as tracer:
        # Two million rays, generated on the workers, in chunks of half a million.
        directions = da.random.default_rng(7).normal(size=(2_000_000, 3), chunks=(500_000, 3))
        hits = tracer.first_hit(middle, directions)
        seen = (
            hits.is_hit.mean(),
            da.linalg.norm(hits.positions[hits.is_hit] - middle, axis=1).max(),
        )
        share, farthest = da.compute(*seen)
        print(f"{share:.1%} of {hits.shape[0]:,} rays hit, at most {farthest:.0f} away")

        image = rs.cluster.render(scene, "whitted", (320, 240), samples=4, client=tracer.client)
        image.save("cluster.png")
        alone = rs.render(scene, "whitted", (320, 240), samples=4)
        assert (image.pixels == alone.pixels).all()
        print("wrote cluster.png")


if __name__ == "__main__":
    if importlib.util.find_spec("distributed") is None:
        print("no cluster: pip install raystream[cluster]")
    else:
        main()
