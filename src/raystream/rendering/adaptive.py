"""Adaptive sampling: rounds in which noisy tiles get more samples than others."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.rendering.film import Film

__all__ = ["FIRST_SAMPLES", "TILE", "Rounds", "Tiles", "Unit"]

#: Side of a tile in pixels. All pixels of a tile have the same number of samples.
TILE = 8

#: Samples of every pixel before their variance is meaningful.
FIRST_SAMPLES = 8

#: Samples after a round, relative to those before it.
GROWTH = 1.5

#: Least share of samples of a tile, relative to the mean: its noise may not have been seen yet.
LEAST_SHARE = 1 / 8

#: Steps of the bisection of shares: to the last bits of a float64.
_BISECTIONS = 64

_NONE = np.empty(0, np.int64)


class Unit(NamedTuple):
    """One sample of some pixels.

    Attributes
    ----------
    samples : ndarray of shape (T,), int64
        Its number in the pixels of each tile; or one for the whole image.
    tiles : ndarray of shape (T,), int64
        Ascending numbers of tiles; none for the whole image.
    """

    samples: NDArray[np.int64]
    tiles: NDArray[np.int64] = _NONE


class Tiles:
    """The tiles of an image, row by row; those at the right and at the bottom may be smaller.

    Parameters
    ----------
    width, height : int
        Of the image, in pixels.

    Attributes
    ----------
    columns, rows : int
    sizes : ndarray of shape (T,), int64
        Pixels of each tile.
    """

    def __init__(self, width: int, height: int) -> None:
        self._width, self._height = width, height
        self.columns, self.rows = -(-width // TILE), -(-height // TILE)
        across = np.minimum(width - TILE * np.arange(self.columns), TILE)
        down = np.minimum(height - TILE * np.arange(self.rows), TILE)
        self.sizes: NDArray[np.int64] = np.outer(down, across).ravel()

    def corners(self, tiles: NDArray[np.int64]) -> NDArray[np.int64]:
        """First column and row of some tiles, their widths and heights: shape (T, 4)."""
        row, column = np.divmod(tiles, self.columns)
        x, y = column * TILE, row * TILE
        right, bottom = np.minimum(self._width - x, TILE), np.minimum(self._height - y, TILE)
        return np.stack([x, y, right, bottom], axis=1)

    def pixels(self, tiles: NDArray[np.int64]) -> NDArray[np.int64]:
        """Numbers of the pixels of some tiles, one tile after another, each row by row."""
        row, column = np.divmod(tiles, self.columns)
        y = row[:, None] * TILE + np.arange(TILE)
        x = column[:, None] * TILE + np.arange(TILE)
        numbers = y[:, :, None] * self._width + x[:, None, :]
        return numbers[(y < self._height)[:, :, None] & (x < self._width)[:, None, :]]

    def size_of(self, unit: Unit) -> int:
        """Number of pixels of a unit's tiles."""
        return int(self.sizes[unit.tiles].sum())

    def means(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """The mean of each tile's pixels, for values of shape (H * W,)."""
        padded = np.zeros((self.rows * TILE, self.columns * TILE))
        padded[: self._height, : self._width] = values.reshape(self._height, self._width)
        sums = padded.reshape(self.rows, TILE, self.columns, TILE).sum(axis=(1, 3))
        return sums.ravel() / self.sizes

    def counts(self, film: Film) -> NDArray[np.int64]:
        """Samples of the first pixel of each tile."""
        counts = film.counts.reshape(self._height, self._width)
        return counts[::TILE, ::TILE].ravel()

    def fit(self, film: Film) -> bool:
        """Whether a film has this size, and in each tile one number of samples and one target."""
        if (film.width, film.height) != (self._width, self._height):
            return False
        if film.targets is not None and len(film.targets) != len(self.sizes):
            return False
        counts = self.counts(film).reshape(self.rows, self.columns)
        each = counts.repeat(TILE, axis=0)[: self._height]
        each = each.repeat(TILE, axis=1)[:, : self._width]
        return np.array_equal(each.ravel(), film.counts)

    def smoothed(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values of tiles, averaged over squares of 5 x 5 tiles with binomial weights."""
        smooth = values.reshape(self.rows, self.columns)
        for axis in (0, 1, 0, 1):
            padded = np.pad(smooth, [(1, 1) if k == axis else (0, 0) for k in (0, 1)], "edge")
            before, after = (
                padded.take(range(smooth.shape[axis]), axis),
                padded.take(range(2, smooth.shape[axis] + 2), axis),
            )
            smooth = (before + 2.0 * smooth + after) / 4.0
        return smooth.ravel()


class Rounds:
    """The samples that the tiles of a film get, pass by pass.

    A round decides on the number of samples of each tile (`Film.targets`) from the film, which
    nothing else depends on: not the time, threads, or interruptions. Its passes have samples of
    about as many pixels as the image has.

    Parameters
    ----------
    film : Film
    most : int
        Upper bound of the samples of a pixel.
    is_adaptive : bool
        False for rounds that give all tiles as many samples as one has already.
    """

    def __init__(self, film: Film, most: int, is_adaptive: bool) -> None:
        self._film, self._most, self._is_adaptive = film, most, is_adaptive
        self._tiles = Tiles(film.width, film.height)

    def begin(self) -> list[Unit]:
        """The units of the round that the film is in, or of a new one; none at the upper bound."""
        film, counts = self._film, self._tiles.counts(self._film)
        most = np.maximum(counts, self._most)
        if film.targets is not None and self._is_adaptive:
            targets = np.minimum(film.targets, most)
            if (targets > counts).any():
                return list(_units(counts, targets))
        if self._is_adaptive and counts.min() >= FIRST_SAMPLES:
            targets = _targets(film, self._tiles, counts, most)
        else:
            level = FIRST_SAMPLES if self._is_adaptive else int(counts.max())
            targets = np.maximum(counts, min(level, self._most))
        film.targets = targets
        return list(_units(counts, targets))

    def passes(self, units: Iterable[Unit]) -> Iterator[list[Unit]]:
        """A round's units, in passes of at least as many pixels as the image has, but the last."""
        taken: list[Unit] = []
        pixel_count = 0
        for unit in units:
            taken.append(unit)
            pixel_count += self._tiles.size_of(unit)
            if pixel_count >= len(self._film.counts):
                yield taken
                taken, pixel_count = [], 0
        if taken:
            yield taken


def _units(counts: NDArray[np.int64], targets: NDArray[np.int64]) -> Iterator[Unit]:
    """The samples that tiles need for their targets, in as few units as the neediest tile allows.

    Units have about equal numbers of tiles, since small ones take longer per path. The next unit
    depends only on the samples that are missing, so that a round can be continued anywhere.
    """
    counts = counts.copy()
    left = targets - counts
    for units_left in range(int(left.max(initial=0)), 0, -1):
        needy = np.flatnonzero(left)
        order = needy[np.argsort(-left[needy], kind="stable")]
        needed = int(np.count_nonzero(left == units_left))
        tiles = np.sort(order[: max(needed, -(-int(left.sum()) // units_left))])
        yield Unit(counts[tiles], tiles)
        counts[tiles] += 1
        left[tiles] -= 1


def _targets(
    film: Film, tiles: Tiles, counts: NDArray[np.int64], most: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Numbers of samples of tiles that leave the least error for the budget of a round.

    Notes
    -----
    With N samples in a tile of P pixels whose samples deviate by s, the sum of its pixels'
    absolute errors is proportional to P s N^(-1/2). If a sample takes the time c, the sum over all
    tiles is least, for a given sum of P N c, if N is proportional to (s/c)^(2/3) (by a Lagrange
    multiplier). Paths take longer where they find more noise: as if c were s^(1/4), N is
    proportional to the root of s.
    """
    weights = np.sqrt(tiles.smoothed(tiles.means(film.deviation())))
    mean = float(np.dot(weights, tiles.sizes)) / float(tiles.sizes.sum())
    weights = np.maximum(weights, LEAST_SHARE * mean) if mean > 0.0 else np.ones(len(weights))
    budget = GROWTH * float(np.dot(counts, tiles.sizes))
    low, high = 0.0, float(most.max() / weights.min())
    for _ in range(_BISECTIONS):
        scale = (low + high) / 2.0
        shares = np.clip(scale * weights, counts, most)
        low, high = (scale, high) if np.dot(shares, tiles.sizes) < budget else (low, scale)
    targets = np.floor(np.clip(high * weights, counts, most) + 0.5).astype(np.int64)
    # A film of few tiles may be rounded to what it has.
    return targets if (targets > counts).any() else np.minimum(counts + 1, most)
