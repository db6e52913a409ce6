"""
Count up
========

A kernel that stops by itself (Christen 2005, listing 4.4).

Each record grows by 0.01 until it would reach 1.0; then the kernel rejects it. The number of calls
until all records are rejected is not known in advance: the loop finds it.
"""

import numpy as np

from raystream.streams import Counters, Kernel, Stream


def count_up(value, step):
    """One step up; None, which rejects the record, if that would reach 1.0."""
    value += step
    if value >= 1.0:
        return None
    return value


start = np.random.default_rng(2005).random(512 * 512, dtype=np.float32)
values = Stream(start, name="values")
kernel = Kernel(
    count_up,
    inputs={"value": values},
    outputs=values,
    constants={"step": np.float32(0.01)},
)

counters = Counters()
calls = kernel.loop(counters=counters)
print(f"{len(values):,} random numbers were counted up to 1.0 in {calls} calls")
print("call  still counting")
for call in range(0, calls, 10):
    written = counters.passes[call].written_count
    print(f"{call + 1:4}  {written:7,} {'#' * (64 * written // len(values))}")
print(f"smallest number at the end: {values.min():.4f}")
print(counters)

assert (values < 1.0).all()
assert (values >= np.float32(0.9899)).all()
assert counters.written_count == counters.words_written["values"]
