"""A tracer that counts by a simple rule, for tests of what shows counts."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from raystream.tracer import Tracer


class CountingTracer(Tracer):
    """After `first_hit`, a ray that hit has 7 steps, 3 cells and as many tests as its prim_id
    says; one that missed has one step, and nothing else.

    Attributes
    ----------
    asked : dict
        Options of the machine, as given.
    """

    def __init__(self, scene, structure="bvh", device="cpu", *, counters=False, **options):
        machine = {key: options.pop(key) for key in ("machine", "scheduler") if key in options}
        self.asked = machine
        self.does_count = counters
        self.counters = None
        super().__init__(scene, structure, device, **options)

    def first_hit(self, origins, directions, **options):
        hits = super().first_hit(origins, directions, **options)
        if self.does_count:
            self.counters = SimpleNamespace(
                steps=np.where(hits.is_hit, 7, 1).astype(np.uint32),
                cells=np.where(hits.is_hit, 3, 0).astype(np.uint32),
                tests=np.maximum(hits.prim_id, 0).astype(np.uint32),
            )
        return hits
