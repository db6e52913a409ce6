"""Sampler: random numbers of samples, drawn in kernels or as NumPy arrays."""

from __future__ import annotations

import operator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.memory import check_memory
from raystream.core.rays import as_host_array
from raystream.jit.constants import BYTES_32
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import f32x16, lane, lane_count, load, scratch, store
from raystream.jit.threads import parallel_for
from raystream.rendering.sampling import owen, random, stratified

#: Names of kinds; the index is `Sampler.kind`.
KINDS = ("sobol", "stratified", "random")

_SOBOL, _STRATIFIED = 0, 1

#: Most samples with different numbers: a float32 below 1 has 24 bits.
MAX_SAMPLES = 1 << 24

#: Upper bound of pixels, samples, dimensions and seeds.
_RANGE = 1 << 32

#: Rows per task of a thread.
_CHUNK = 1 << 12

# Bytes of a float32, and of 16 of them.
_ROW = 64


class Sampler(NamedTuple):
    """A generator of the random numbers of an image's samples.

    Made by `Sampler.of`; `draw` and `draw_pair` use it in kernels. A number depends only on
    the sampler, pixel, sample and dimension, not on threads or earlier numbers. So an image can be
    rendered in any order, and get more samples later.

    Attributes
    ----------
    kind : int
        Index into `KINDS`.
    seed : int
        0 to 2**32 - 1.
    sample_count : int
        Samples per pixel. Used by the kind "stratified" only.

    Examples
    --------
    >>> sampler = Sampler.of("sobol", samples=4)
    >>> points = sampler.numbers(7, [0, 1, 2, 3], dimension=0, count=2)
    >>> np.sort((points * 4).astype(int), axis=0).tolist()
    [[0, 0], [1, 1], [2, 2], [3, 3]]
    """

    kind: int
    seed: int
    sample_count: int

    @classmethod
    def of(cls, name: str, seed: int = 0, samples: int = 1) -> Sampler:
        """Choose a sampler by name.

        Parameters
        ----------
        name : {"sobol", "stratified", "random"}
        seed : int
            0 to 2**32 - 1.
        samples : int
            Per pixel, 1 to `MAX_SAMPLES`.

        Raises
        ------
        ValueError
            If the name is unknown, or a number is out of range.
        TypeError
            If a number is not an integer.
        """
        if name not in KINDS:
            raise ValueError(f"name: expected one of {', '.join(KINDS)}, got {name!r}")
        return cls(
            KINDS.index(name),
            _integer("seed", seed, 0, _RANGE - 1),
            _integer("samples", samples, 1, MAX_SAMPLES),
        )

    def numbers(
        self, pixels: Any, samples: Any, dimension: int = 0, count: int = 1
    ) -> NDArray[np.float32]:
        """Draw the numbers of samples, outside of kernels.

        Parameters
        ----------
        pixels, samples : array_like of shape (N,), or a number for all
            Integers, 0 to 2**32 - 1.
        dimension : int
            The first dimension. An even one and the next, such as 0 and 1, form a pair.
        count : int
            Number of dimensions.

        Returns
        -------
        ndarray of shape (N, count), float32
            In [0, 1).

        Raises
        ------
        ValueError
            If shapes do not agree, or a number is out of range.
        TypeError
            If a number is not an integer.
        MemoryError
            If the numbers do not fit into memory.
        """
        dimension = _integer("dimension", dimension, 0, _RANGE - 1)
        count = _integer("count", count, 0, _RANGE - dimension)
        pixels, samples = _integers("pixels", pixels), _integers("samples", samples)
        if pixels.ndim and samples.ndim and len(pixels) != len(samples):
            raise ValueError(
                f"pixels, samples: expected equal lengths, got {len(pixels)} and {len(samples)}"
            )
        length = len(pixels) if pixels.ndim else len(samples) if samples.ndim else 1
        check_memory(4 * length * count, f"{length:,} x {count:,} numbers would")
        out = np.empty((length, count), np.float32)
        pixels = np.broadcast_to(pixels, length)
        samples = np.broadcast_to(samples, length)
        parallel_for(
            lambda begin, end: _fill(begin, end, self, pixels, samples, dimension, out),
            length,
            _CHUNK,
            joins_chunks=True,
        )
        return out


class PixelSample(NamedTuple):
    """One sample of every pixel, as kernels draw its numbers.

    Attributes
    ----------
    sampler : Sampler
    number : int
        Of the sample, from 0.
    """

    sampler: Sampler
    number: int


def _integer(name: str, value: Any, least: int, most: int) -> int:
    try:
        number = operator.index(value)
    except TypeError:
        raise TypeError(f"{name}: expected an integer, got {type(value).__name__}") from None
    if not least <= number <= most:
        raise ValueError(f"{name}: expected {least:,} to {most:,}, got {number:,}")
    return number


def _integers(name: str, values: Any) -> NDArray[np.uint32]:
    array = as_host_array(name, values)
    if array.ndim > 1:
        raise ValueError(f"{name}: expected one dimension, got shape {array.shape}")
    if array.size == 0:
        return np.empty(array.shape, np.uint32)
    if array.dtype.kind not in "iu":
        raise TypeError(f"{name}: expected integers, got dtype {array.dtype}")
    least, most = int(array.min()), int(array.max())
    if least < 0 or most >= _RANGE:
        wrong = least if least < 0 else most
        raise ValueError(f"{name}: expected 0 to {_RANGE - 1:,}, got {wrong:,}")
    return array.astype(np.uint32)


@device
def draw(sampler, pixel, sample, dimension):
    """One number of one sample.

    Parameters
    ----------
    sampler : Sampler
    pixel, sample, dimension : int
        0 to 2**32 - 1.

    Returns
    -------
    float32
        In [0, 1).
    """
    if sampler.kind == _SOBOL:
        return owen.sample_number(sampler.seed, pixel, sample, dimension)
    if sampler.kind == _STRATIFIED:
        count = sampler.sample_count
        return stratified.sample_number(sampler.seed, pixel, sample, dimension, count)
    return random.sample_number(sampler.seed, pixel, sample, dimension)


@device
def draw_pair(sampler, pixel, sample, dimension):
    """The numbers of an even dimension and the next: two float32, stratified over the square.

    The same as from `draw`, in less than twice the time.
    """
    if sampler.kind == _SOBOL:
        return owen.sample_pair(sampler.seed, pixel, sample, dimension)
    if sampler.kind == _STRATIFIED:
        count = sampler.sample_count
        return stratified.sample_pair(sampler.seed, pixel, sample, dimension, count)
    return random.sample_pair(sampler.seed, pixel, sample, dimension)


@device
def draw_lanes(sampler, pixels, samples, dimension):
    """`draw` for 16 pixels and samples, `u32x16`: an `f32x16` with the same bits."""
    if sampler.kind == _SOBOL:
        return owen.sample_number(sampler.seed, pixels, samples, dimension)
    if sampler.kind == _STRATIFIED:
        numbers, count = scratch(_ROW), sampler.sample_count
        for i in range(lane_count(pixels)):
            pixel, sample = lane(pixels, i), lane(samples, i)
            number = stratified.sample_number(sampler.seed, pixel, sample, dimension, count)
            store(numbers + np.uint64(i) * BYTES_32, number)
        return load(f32x16, numbers)
    return random.sample_number(sampler.seed, pixels, samples, dimension)


@device
def draw_pair_lanes(sampler, pixels, samples, dimension):
    """`draw_pair` for 16 pixels and samples, `u32x16`: two `f32x16` with the same bits."""
    if sampler.kind == _SOBOL:
        return owen.sample_pair(sampler.seed, pixels, samples, dimension)
    if sampler.kind == _STRATIFIED:
        us, vs, count = scratch(_ROW), scratch(_ROW), sampler.sample_count
        for i in range(lane_count(pixels)):
            pixel, sample = lane(pixels, i), lane(samples, i)
            u, v = stratified.sample_pair(sampler.seed, pixel, sample, dimension, count)
            store(us + np.uint64(i) * BYTES_32, u)
            store(vs + np.uint64(i) * BYTES_32, v)
        return load(f32x16, us), load(f32x16, vs)
    return random.sample_pair(sampler.seed, pixels, samples, dimension)


@kernel
def _fill(begin, end, sampler, pixels, samples, dimension, out):
    """Draw the numbers of rows begin to end."""
    count = out.shape[1]
    odd = min(dimension & 1, count)
    for i in range(begin, end):
        pixel, sample = pixels[i], samples[i]
        if odd:
            out[i, 0] = draw(sampler, pixel, sample, dimension)
        for k in range(odd, count - 1, 2):
            pair = draw_pair(sampler, pixel, sample, dimension + k)
            out[i, k], out[i, k + 1] = pair
        if (count - odd) & 1:
            out[i, count - 1] = draw(sampler, pixel, sample, dimension + count - 1)
