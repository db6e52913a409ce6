"""View: what is rendered for one visitor, from the first quick picture to the last sample."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.render.picture import RENDERERS
from raystream.scene.camera import Camera
from raystream.viewer.messages import Message
from raystream.viewer.pacing import Cost, Resolution
from raystream.viewer.pictures import (
    BrokenOffError,
    Picture,
    SampledPicture,
    centered,
    spread,
)
from raystream.viewer.settings import Look, Settings
from raystream.viewer.tracers import Prepared

__all__ = ["Shot", "View", "Wish"]

#: A picture of a moving camera that is nearly done is shown, though the camera has moved on.
_SOON = 0.25

#: A first picture that would take longer is preceded by a smaller one.
_PATIENCE = 0.5

#: Seconds between two pictures while samples are gathered: at first, in proportion to the time
#: that has gone by, and at last.
_FIRST_PAUSE, _PAUSE_SHARE, _LAST_PAUSE = 0.1, 0.15, 2.0

#: Modes and tracers whose cost is remembered.
_MOST_COSTS = 64


class Wish(NamedTuple):
    """What a visitor wants to see.

    Attributes
    ----------
    prepared : Prepared
    settings : Settings
    camera : Camera
    number : int
        Of the message that brought the camera.
    size : (int, int)
        Of the canvas.
    moving : bool
        Whether the camera is about to move on.
    """

    prepared: Prepared
    settings: Settings
    camera: Camera
    number: int
    size: tuple[int, int]
    moving: bool

    @property
    def subject(self) -> tuple[Any, ...]:
        """All that samples depend on, but for the camera."""
        plain = replace(self.settings, exposure=1.0, tone="linear", maximum=None)
        return id(self.prepared), plain, self.size

    @property
    def sight(self) -> tuple[Any, ...]:
        """All that samples depend on."""
        return *self.subject, self.camera


class Shot(NamedTuple):
    """A picture to be encoded and sent.

    Attributes
    ----------
    pixels : ndarray of shape (H, W, 3), float32
        Linear RGB.
    look : Look
    header : dict
    """

    pixels: NDArray[np.float32]
    look: Look
    header: Message


class View:
    """Renders what a visitor wishes, a slice at a time; for the worker's thread.

    Parameters
    ----------
    show : callable
        Is given each picture as it is ready.
    """

    def __init__(self, show: Callable[[Shot], object]) -> None:
        self._show = show
        self._resolution = Resolution()
        self._costs: dict[Any, Cost] = {}
        self._wish: Wish | None = None
        self._picture: Picture | None = None
        self._is_quick = False
        self._shown: tuple[Any, ...] | None = None  # the sight that was seen in any size
        self._whole: Picture | None = None  # the best picture of the sight, in full size
        self._look: Look | None = None
        self._since = self._sent = 0.0
        self._wanted_since: float | None = None
        self._noise: float | None = None
        self._moments: deque[float] = deque(maxlen=256)

    def has_work(self, wish: Wish) -> bool:
        """Whether there is anything to render for a wish."""
        last = self._wish
        if last is None or last.sight != wish.sight:
            return True
        if wish.moving:
            return self._shown != wish.sight
        if self._whole is None or not self._is_complete(wish):
            return True
        return self._look != wish.settings.look

    def step(self, wish: Wish, seconds: float, is_wanted: Callable[[View], bool]) -> None:
        """Do a slice of work.

        Parameters
        ----------
        wish : Wish
        seconds : float
            What the slice may take.
        is_wanted : callable
            Whether the work that it is at still is; see `is_worth`.
        """
        self._take(wish)
        if self._picture is None and self._begin(wish) is None:
            return
        picture = self._picture
        assert picture is not None
        try:
            is_whole = picture.advance(seconds, lambda: is_wanted(self))
        except BrokenOffError:
            self._picture = None
            return
        if is_whole:
            self._finish(picture)
        elif self._whole is None and self._shown != wish.sight and not self._is_quick:
            self._hurry(picture, wish)

    def _hurry(self, picture: Picture, wish: Wish) -> None:
        """Make a smaller picture first, if the one that is begun takes long."""
        if picture.seconds_left > _PATIENCE:
            self._resolution.note(*wish.size, picture.width, picture.seconds_of_row)
            self._begin_quick(wish)

    def is_worth(self, wish: Wish) -> bool:
        """Whether the picture in the making is still worth its time."""
        made = self._wish
        picture = self._picture
        if made is None or picture is None:
            return False
        if made.sight == wish.sight and (self._is_quick or not wish.moving):
            return True
        is_same = made.subject == wish.subject
        return is_same and self._is_quick and wish.moving and picture.seconds_left < _SOON

    def forget(self) -> None:
        """Begin anew with the next wish, after an error."""
        self._picture = self._whole = None
        self._wish = self._shown = None

    def _take(self, wish: Wish) -> None:
        """Drop what is not wanted any more."""
        last = self._wish
        if last is not None and last.sight == wish.sight:
            if self._picture is not None and self._is_quick and not wish.moving:
                self._picture = None  # the full size, at once
            if self._picture is None or not self._is_quick:
                self._wish = wish
            return
        if self._picture is not None and self.is_worth(wish):
            return
        self._picture = self._whole = None
        self._noise = None
        self._wish = wish
        self._since = time.perf_counter()
        self._sent = 0.0
        if last is None or last.subject != wish.subject:
            self._resolution = Resolution()
            self._shown = None
        if self._wanted_since is None:
            self._wanted_since = self._since

    def _begin(self, wish: Wish) -> Picture | None:
        """Choose the next picture for a wish; None if there is nothing to do."""
        wish = self._wish = (
            wish
            if self._wish is None
            else self._wish._replace(settings=wish.settings, moving=wish.moving)
        )
        if wish.moving:
            if self._shown != wish.sight:
                self._begin_quick(wish)
        elif self._whole is None:
            self._picture, self._is_quick = self._make(wish, wish.size, 1), False
        elif not self._is_complete(wish):
            self._picture = self._make(wish, wish.size, wish.settings.target_samples)
            self._is_quick = False
        elif self._look != wish.settings.look:
            self._send(self._whole, wish)
        return self._picture

    def _begin_quick(self, wish: Wish) -> None:
        self._picture = self._make(wish, self._resolution.size(*wish.size), 1)
        self._is_quick = True

    def _is_complete(self, wish: Wish) -> bool:
        whole = self._whole
        return whole is not None and whole.samples >= wish.settings.target_samples

    def _make(self, wish: Wish, size: tuple[int, int], samples: int) -> Picture:
        settings = wish.settings
        what = wish.prepared.key, settings.mode, settings.max_bounces
        if len(self._costs) >= _MOST_COSTS:
            self._costs.clear()
        cost = self._costs.setdefault(what, Cost())
        setting = replace(wish.prepared.setting, options=settings.mode_options)
        setting = setting.seen_by(wish.camera, size)
        setting = centered(setting) if samples == 1 else spread(setting, samples)
        return SampledPicture(RENDERERS[settings.mode], setting, cost)

    def _finish(self, picture: Picture) -> None:
        """Show a picture that has one more sample."""
        wish = self._wish
        assert wish is not None
        now = time.perf_counter()
        if self._is_quick:
            self._picture = None
            self._shown = wish.sight
            if self._wanted_since is not None:
                spent = now - self._wanted_since
                self._resolution.note(*wish.size, picture.width * picture.height, spent)
            self._wanted_since = now if wish.moving else None
            self._moments.append(now)
            if picture.width == wish.size[0] and picture.height == wish.size[1]:
                self._whole = picture
            self._send(picture, wish)
            return
        is_first = self._whole is None
        if is_first or picture.samples > 1 or picture.is_done:
            self._whole = picture
        self._shown = wish.sight
        self._wanted_since = None
        if picture.is_done:
            self._picture = None
        pause = min(max(_FIRST_PAUSE, _PAUSE_SHARE * (now - self._since)), _LAST_PAUSE)
        if self._whole is picture and (is_first or picture.is_done or now - self._sent >= pause):
            self._send(picture, wish)

    def _send(self, picture: Picture, wish: Wish) -> None:
        settings = wish.settings
        now = time.perf_counter()
        if picture.samples > 1 and (
            picture.samples & (picture.samples - 1) == 0 or picture.is_done
        ):
            self._noise = picture.noise()
        self._look = settings.look
        self._sent = now
        target = settings.target_samples
        rays = picture.width * picture.height
        header = {
            "type": "frame",
            "camera": wish.number,
            "width": picture.width,
            "height": picture.height,
            "samples": picture.samples,
            "target_samples": target,
            "done": not self._is_quick_now(picture, wish) and picture.samples >= target,
            "moving": wish.moving,
            "render_ms": round(1e3 * picture.seconds, 3),
            "fps": self._fps(now),
            "rays": rays,
            "mrays_per_second": round(rays / max(picture.seconds, 1e-9) / 1e6, 3),
            "noise": self._noise if picture.samples > 1 else None,
            "counters": None,
        }
        self._show(Shot(picture.pixels(), settings.look, header))

    @staticmethod
    def _is_quick_now(picture: Picture, wish: Wish) -> bool:
        return wish.moving or (picture.width, picture.height) != wish.size

    def _fps(self, now: float) -> float:
        """Pictures of the moving camera in a second, over the last second."""
        recent = [moment for moment in self._moments if now - moment <= 1.0]
        if len(recent) < 2:
            return 0.0
        return round((len(recent) - 1) / max(recent[-1] - recent[0], 1e-9), 2)
