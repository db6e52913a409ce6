"""Animation: motion of a scene's meshes and lights, and the times of its frames."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from raystream.scene.scene import Scene

__all__ = ["FPS", "Animation", "Timeline"]

#: Default number of frames per unit of time.
FPS = 24.0

#: More frames than this are assumed to be a mistake.
MAX_FRAMES = 10_000_000


@dataclass(frozen=True, eq=False)
class Animation:
    """Motion of the meshes and lights of a scene.

    Parameters
    ----------
    at : callable
        Maps a time to a `Scene` whose meshes, materials and lights make the frame. If the
        number of meshes and their faces stay the same, an existing structure is updated (see
        `Tracer.update`); static meshes should be the same objects.
    times : (float, float)
        Start and end; seconds in most files.
    fps : float
        Frames per unit of time.

    Raises
    ------
    ValueError
        If the end is not after the start, a number is not finite, or there would be more than
        10 million frames.

    Examples
    --------
    >>> import numpy as np
    >>> import raystream as rs
    >>> triangle = rs.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    >>> def at(time):
    ...     return rs.Scene([triangle.moved(triangle.vertices + [time, 0, 0])])
    >>> scene = rs.Scene([triangle], animation=rs.Animation(at, (0, 2), fps=10))
    >>> scene.at(0.5).meshes[0].vertices[0].tolist()
    [0.5, 0.0, 0.0]
    >>> scene.timeline().frame_count
    20
    """

    at: Callable[[float], Scene] = field(repr=False)
    times: tuple[float, float]
    fps: float = FPS

    def __post_init__(self) -> None:
        self.timeline()

    def timeline(self, fps: float | None = None) -> Timeline:
        """The frames, at a given rate or the animation's own."""
        return Timeline(*self.times, self.fps if fps is None else fps)


@dataclass(frozen=True)
class Timeline:
    """The frames of an animated scene: frame i is at the time ``start + i / fps``.

    Frames start at `start` and stop before `end`, so that a periodic motion loops seamlessly.

    Attributes
    ----------
    start, end : float
    fps : float
        Frames per unit of time.
    """

    start: float
    end: float
    fps: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.start) and math.isfinite(self.end) and self.end > self.start):
            raise ValueError(
                f"times: expected a start and a later end, got {self.start} and {self.end}"
            )
        if not (math.isfinite(self.fps) and self.fps > 0.0):
            raise ValueError(f"fps: expected a number above 0, got {self.fps}")
        if not (self.end - self.start) * self.fps <= MAX_FRAMES:
            raise ValueError(
                f"fps: {self.fps:g} from {self.start:g} to {self.end:g} gives more than "
                f"{MAX_FRAMES:,} frames"
            )

    @property
    def frame_count(self) -> int:
        """Number of frames, at least one."""
        # A tiny remainder is rounding, not another frame.
        return max(1, math.ceil((self.end - self.start) * self.fps - 1e-6))

    def time_of(self, frame: int) -> float:
        """The time of a frame."""
        return self.start + frame / self.fps

    def chosen(self, frames: slice | int | Iterable[int] | None = None) -> tuple[int, ...]:
        """Return the numbers of the chosen frames.

        Parameters
        ----------
        frames : slice, int or iterable of int, optional
            Python indices: ``slice(0, 100, 5)``, ``-1`` for the last [default: all]. Unlike in
            Python, the ends of a slice must be in range.

        Returns
        -------
        tuple of int
            From 0 to `frame_count` - 1.

        Raises
        ------
        ValueError
            If a frame or an end of a slice is out of range, or no frame is chosen.
        """
        count = self.frame_count
        if frames is None:
            return tuple(range(count))
        if isinstance(frames, slice):
            for end in (frames.start, frames.stop):
                if end is not None and not -count <= operator.index(end) <= count:
                    raise self._outside(end)
            if frames.step == 0:
                raise ValueError("frames: expected a step other than 0")
            chosen = tuple(range(count)[frames])
        else:
            numbers = frames if isinstance(frames, Iterable) else [frames]
            chosen = tuple(self._frame(operator.index(number)) for number in numbers)
        if not chosen:
            raise ValueError(f"frames: selects none of {count:,} frames")
        return chosen

    def _frame(self, number: int) -> int:
        if not -self.frame_count <= number < self.frame_count:
            raise self._outside(number)
        return number % self.frame_count

    def _outside(self, number: int) -> ValueError:
        last = self.frame_count - 1
        return ValueError(
            f"frames: expected 0 to {last} ({self.fps:g} per unit of time), got {number}"
        )
