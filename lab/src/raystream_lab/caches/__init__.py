"""Cache simulators over traces of memory references.

A trace is an array of byte addresses in read order, processed in chunks::

    cache = Cache(64 * 1024, 48, kinds=("cells", "vertices"))
    distances = ReuseDistances(48, kinds=("cells", "vertices"))
    for addresses, kinds in trace:
        cache.access(addresses, kinds, 12)
        distances.access(addresses, kinds, 12)
    cache.counts["vertices"].hit_rate distances.counts(1 << 20)["vertices"].hit_rate # 1 MB, or any
    other size

`Cache` is one cache: direct-mapped, set-associative or fully associative. `ReuseDistances` gives
the misses of fully associative caches of every size from one run. `feed_chunks` runs several
simulators in parallel.
"""

from raystream_lab.caches.cache import Cache
from raystream_lab.caches.feed import feed_chunks
from raystream_lab.caches.line_counts import LineCounts
from raystream_lab.caches.reuse_distances import MissCurve, ReuseDistances

__all__ = ["Cache", "LineCounts", "MissCurve", "ReuseDistances", "feed_chunks"]
