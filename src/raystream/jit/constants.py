"""Constants of kernels, with their types in their names."""

from __future__ import annotations

import numpy as np

ZERO_U64, ONE_U64, TWO_U64, THREE_U64 = np.uint64(0), np.uint64(1), np.uint64(2), np.uint64(3)
ZERO_F32, ONE_F32, INF_F32 = np.float32(0.0), np.float32(1.0), np.float32(np.inf)
ZERO_F64, ONE_F64, INF_F64 = np.float64(0.0), np.float64(1.0), np.float64(np.inf)

#: The address of an array that is absent.
NULL = np.uint64(0)

#: Sizes of 32-bit and 64-bit numbers, and shifts that turn an index of them into bytes.
BYTES_32, BYTES_64 = np.uint64(4), np.uint64(8)
SHIFT_32, SHIFT_64 = np.uint64(2), np.uint64(3)

#: Two 32-bit numbers in a uint64: the shift of the upper one, and the mask of the lower one.
BITS_32, LOW_32 = np.uint64(32), np.uint64(0xFFFFFFFF)
