"""Caches, simulated over a trace of memory references.

A trace is an array of byte addresses in the order in which they were read, and goes through a
simulator in chunks::

    cache = Cache(64 * 1024, 48, kinds=("cells", "vertices"))
    distances = ReuseDistances(48, kinds=("cells", "vertices"))
    for addresses, kinds in trace:
        cache.access(addresses, kinds, 12)
        distances.access(addresses, kinds, 12)
    cache.counts["vertices"].hit_rate
    distances.counts(1 << 20)["vertices"].hit_rate  # of one MB, or of any other size

`Cache` is one cache: direct-mapped, set-associative or fully associative. `ReuseDistances`
tells from one run what every size of a fully associative cache would miss. `feed_chunks` runs
several of them side by side.
"""

from raystream.lab.caches.cache import Cache
from raystream.lab.caches.feed import feed_chunks
from raystream.lab.caches.line_counts import LineCounts
from raystream.lab.caches.reuse_distances import MissCurve, ReuseDistances

__all__ = ["Cache", "LineCounts", "MissCurve", "ReuseDistances", "feed_chunks"]
