"""Streams, gather arrays, kernels, chains and loops: the stream programming model.

Independent of rays. A kernel is a function of one record, run over all records of streams.

>>> import numpy as np
>>> from raystream.streams import Kernel, Stream
>>> values = Stream(np.array([1.0, 2.0, 3.0]))
>>> squares = Stream.zeros(3)
>>> Kernel(lambda x: x * x, inputs={"x": values}, outputs=squares).execute()
3
>>> squares.array
array([1., 4., 9.])
"""

from raystream.core.errors import LoopLimitError
from raystream.jit.cpu import device
from raystream.streams.chains import Count, Repeat, Sequential, Step, While
from raystream.streams.condition import Condition
from raystream.streams.counters import Counters, Pass
from raystream.streams.gather import GatherArray
from raystream.streams.kernel import INDEX, Kernel
from raystream.streams.stream import Stream

__all__ = [
    "INDEX",
    "Condition",
    "Count",
    "Counters",
    "GatherArray",
    "Kernel",
    "LoopLimitError",
    "Pass",
    "Repeat",
    "Sequential",
    "Step",
    "Stream",
    "While",
    "device",
]
