"""
Sort on the graphics device
===========================

A network of comparisons: one pass of a kernel for each layer.

A kernel writes only its own record, so each record reads its partner and keeps the smaller or the
larger of the two: Batcher's bitonic sort, used for the photons of Purcell et al., "Photon Mapping
on Programmable Graphics Hardware", Graphics Hardware 2003. The number of passes is known in
advance: log2(N) (log2(N) + 1) / 2.
"""

import numpy as np

from raystream.graphics.errors import GraphicsError
from raystream.graphics.streams import INDEX, Counters, Kernel, Stream

COUNT = 1 << 14

EXCHANGE = """
fn exchange(own: vec2f, i: u32, block: u32, distance: u32) -> vec2f {
    let partner = i ^ distance;
    let other = records(i32(partner));
    let is_ascending = (i & block) == 0u;
    let wants_smaller = (i < partner) == is_ascending;
    // Equal keys are ordered by their values, so that both partners decide alike.
    let is_smaller = own.x < other.x || (own.x == other.x && own.y < other.y);
    if is_smaller == wants_smaller { discard; }
    return other;
}
"""


def main() -> None:
    """Sort random keys, and check the result."""
    keys = np.random.default_rng(2005).random(COUNT, dtype=np.float32)
    values = np.stack([keys, np.arange(COUNT, dtype=np.float32)], axis=1)
    records = Stream(values, name="records")
    exchange = Kernel(
        EXCHANGE,
        inputs={"own": records, "i": INDEX},
        outputs=records,
        gathers={"records": records},
        constants={"block": 0, "distance": 0},
    )
    counters = Counters()
    block = 2
    while block <= COUNT:
        distance = block // 2
        while distance:
            exchange.set_constants(block=block, distance=distance)
            exchange.execute(counters=counters)
            distance //= 2
        block *= 2
    order = records.array[:, 1].astype(np.int64)
    assert (order == np.argsort(keys, kind="stable")).all()
    print(f"{COUNT:,} keys are sorted after {counters.pass_count} passes")
    print(counters)


if __name__ == "__main__":
    try:
        main()
    except GraphicsError as error:  # no adapter, or wgpu is not installed
        print(error)
