"""AFF animation: keyframes of translation, rotation, scale and visibility."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from raystream.scene.camera_track import keys_span
from raystream.scene.io.aff_words import Words
from raystream.scene.io.text import shown
from raystream.scene.splines import (
    key_turns,
    position_at,
    quaternion_matrix,
    rotation_at,
    rotation_matrix,
)

Array = NDArray[np.float64]


@dataclass
class Keyframes:
    """The animation channels of one name.

    Attributes
    ----------
    translation, scale : ndarray of shape (K, 7) or None
        Rows: time, x, y, z, tension, continuity, bias.
    rotation : ndarray of shape (K, 8) or None
        Rows: time, axis x, y, z, degrees, tension, continuity, bias.
    visibility : ndarray of shape (K, 2) or None
        Rows: time, and whether it is visible from then on.
    """

    translation: Array | None = None
    scale: Array | None = None
    rotation: Array | None = None
    visibility: Array | None = None

    @cached_property
    def _turns(self) -> list[Array]:
        return [] if self.rotation is None else key_turns(self.rotation)

    def matrix(self, time: float) -> Array:
        """Return scale, then rotation, then translation; shape (4, 4), column vectors."""
        matrix = np.eye(4)
        with np.errstate(all="ignore"):
            if self.rotation is not None:
                matrix[:3, :3] = quaternion_matrix(rotation_at(self.rotation, time, self._turns))
            if self.scale is not None:
                matrix[:3, :3] *= position_at(self.scale, time)
            if self.translation is not None:
                matrix[:3, 3] = position_at(self.translation, time)
        return matrix

    def spans(self) -> list[tuple[float, float]]:
        """Return start and end of each channel that changes."""
        spans = [
            keys_span(keys[:, 0])
            for keys in (self.translation, self.scale, self.rotation)
            if keys is not None and (keys[:, 1:] != keys[0, 1:]).any()
        ]
        if self.visibility is not None:
            spans.append((float(self.visibility[0, 0]), float(self.visibility[-1, 0])))
        return spans

    def visible(self, time: float) -> bool:
        """Whether it is visible; True before the first key."""
        if self.visibility is None:
            return True
        past = self.visibility[self.visibility[:, 0] <= time]
        return len(past) == 0 or bool(past[-1, 1] != 0.0)


def read_keyframes(words: Words) -> Keyframes:
    """Read ``{ transl n ... rot n ... scale n ... visible n ... }``."""
    keys = Keyframes()
    words.expect(b"{")
    while words.peek() != b"}":
        channel = words.word()
        if channel == b"transl":
            keys.translation = _rows(words, 7)
        elif channel == b"scale":
            keys.scale = _rows(words, 7)
        elif channel == b"rot":
            keys.rotation = _rows(words, 8)
        elif channel.startswith(b"visib"):
            keys.visibility = _rows(words, 2)
        else:
            raise words.error(f"unknown keyframe channel {shown(channel)}")
    words.expect(b"}")
    return keys


def _rows(words: Words, width: int) -> Array:
    count = words.count(width)
    if count == 0:
        raise words.error("a keyframe channel is empty")
    return words.floats(count * width).reshape(count, width)


def static_matrix(numbers: Array) -> Array:
    """Make the matrix of ``xs``: scale, rotation about an axis, translation; (4, 4).

    Parameters
    ----------
    numbers : ndarray of shape (10,)
        Scale x, y, z; axis x, y, z and degrees; translation x, y, z.
    """
    matrix = np.eye(4)
    with np.errstate(all="ignore"):
        matrix[:3, :3] = rotation_matrix(numbers[3:6], float(numbers[6])) * numbers[:3]
    matrix[:3, 3] = numbers[7:]
    return matrix
