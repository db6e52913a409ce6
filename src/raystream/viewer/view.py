"""View: what is rendered for one visitor, from the first quick picture to the last sample."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

from raystream.rendering.picture import RENDERERS
from raystream.scene.camera import Camera
from raystream.viewer.heat import HeatPicture
from raystream.viewer.messages import Message
from raystream.viewer.pacing import Cost, FrameRate, Resolution, pause_after
from raystream.viewer.pictures import (
    BrokenOffError,
    Drawing,
    Picture,
    SampledPicture,
    centered,
    spread,
)
from raystream.viewer.settings import Settings
from raystream.viewer.tracers import Prepared

__all__ = ["Shot", "View", "Wish"]

#: A picture of a moving camera that takes so long, or is so soon done, is finished although the
#: camera has moved on: else there would be none before it rests.
_QUICK, _SOON = 1.0, 0.25

#: A first picture that would take longer is preceded by a smaller one; what has taken less so
#: far says nothing of the rest.
_PATIENCE, _LEAST_SIGN = 0.5, 0.05

#: Modes and tracers whose cost is remembered.
_MOST_COSTS = 64

#: What the picture in the making is for: a camera that moves; something to look at before the
#: full size; the full size at once; or all samples.
_MOVING, _GLANCE, _WHOLE, _SAMPLES = range(4)


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
    draw : callable
        Returns the pixels.
    header : dict
    """

    draw: Callable[[], Drawing]
    header: Message


class View:
    """Renders what a visitor wishes, a slice at a time; for the worker's thread.

    While the camera moves: pictures of one sample through the pixels' centres, as large as the
    frame rate allows. When it rests: one of these in full size, at once; then samples that are
    spread over the pixels, until there are as many as are wanted.

    Parameters
    ----------
    show : callable
        Is given each picture as it is ready, and whether it may be left out.
    """

    def __init__(self, show: Callable[[Shot, bool], object]) -> None:
        self._show = show
        self._resolution = Resolution()
        self._rate = FrameRate()
        self._costs: dict[Any, Cost] = {}
        self.forget()

    def forget(self) -> None:
        """Begin anew with the next wish."""
        self._wish: Wish | None = None  # that of the picture in the making, or of the last one
        self._picture: Picture | None = None
        self._purpose = _WHOLE
        self._seen: Any = None  # the sight of the last picture that was shown
        self._whole: Picture | None = None  # the best picture of this sight in full size
        self._told: Any = None  # what was said of it
        self._noise: float | None = None
        self._rested_at = self._sent_at = 0.0
        self._awaited_at: float | None = None  # since when a picture of the moving camera is

    def has_work(self, wish: Wish) -> bool:
        """Whether there is anything to render or to show for a wish."""
        last = self._wish
        if last is None or last.sight != wish.sight:
            return True
        if wish.moving:
            return self._seen != wish.sight
        return not self._is_complete(wish) or self._told != _tale(wish, self._whole)

    def whole(self, wish: Wish) -> Picture | None:
        """A picture of the wish in full size, if there is one with a sample at least."""
        last = self._wish
        return self._whole if last is not None and last.sight == wish.sight else None

    def header(self, picture: Picture, wish: Wish) -> Message:
        """What is said of a picture."""
        target = wish.settings.target_samples
        rays = picture.width * picture.height
        return {
            "type": "frame",
            "camera": wish.number,
            "width": picture.width,
            "height": picture.height,
            "samples": picture.samples,
            "target_samples": target,
            "done": not wish.moving and picture is self._whole and picture.samples >= target,
            "moving": wish.moving,
            "render_ms": round(1e3 * picture.seconds, 3),
            "fps": self._rate.now(time.perf_counter()),
            "rays": rays,
            "mrays_per_second": round(rays / max(picture.seconds, 1e-9) / 1e6, 3),
            "noise": self._noise if picture.samples > 1 else None,
            **picture.facts(wish.settings.look),
        }

    def step(self, wish: Wish, seconds: float, is_wanted: Callable[[], bool]) -> None:
        """Do a slice of work.

        Parameters
        ----------
        wish : Wish
        seconds : float
            What the slice may take.
        is_wanted : callable
            Whether the work that it is at still is; see `is_worth`.
        """
        wish = self._take(wish)
        if self._picture is None:
            self._begin(wish)
        picture = self._picture
        if picture is None:
            return
        try:
            is_whole = picture.advance(seconds, is_wanted)
        except BrokenOffError:
            self._picture = None
            return
        if is_whole:
            self._finish(picture, wish)
        else:
            self._hurry(picture, wish)

    def is_worth(self, wish: Wish) -> bool:
        """Whether the picture in the making is still worth its time."""
        made, picture = self._wish, self._picture
        if made is None or picture is None:
            return False
        if made.sight == wish.sight:
            return (self._purpose == _MOVING) == wish.moving
        if made.subject != wish.subject or not (self._purpose == _MOVING and wish.moving):
            return False
        left = picture.seconds_left
        return left < _SOON or picture.seconds + left < _QUICK

    def _take(self, wish: Wish) -> Wish:
        """Drop what is not wanted any more; returns the wish that is to be worked on."""
        last = self._wish
        if last is not None and last.sight == wish.sight:
            if self._purpose == _MOVING and not wish.moving:
                self._picture = None  # the full size, at once
            if last.moving and not wish.moving:
                self._rested_at = time.perf_counter()
        else:
            if last is not None and self._picture is not None and self.is_worth(wish):
                return last
            now = time.perf_counter()
            self._picture = self._whole = self._noise = None
            self._rested_at = now
            if last is None or last.subject != wish.subject:
                self._resolution = Resolution()
                self._seen = None
            if self._awaited_at is None:
                self._awaited_at = now
        self._wish = wish
        return wish

    def _begin(self, wish: Wish) -> None:
        """Choose the next picture for a wish, or say something else of the one there is."""
        whole = self._whole
        if wish.moving:
            if self._seen != wish.sight:
                self._begin_small(wish, _MOVING)
        elif whole is None:
            self._make(wish, wish.size, _WHOLE)
        elif not self._is_complete(wish):
            self._make(wish, wish.size, _SAMPLES)
        elif self._told != _tale(wish, whole):
            self._send(whole, wish, may_drop=False)

    def _begin_small(self, wish: Wish, purpose: int) -> None:
        cost = self._cost(wish, is_small=True)
        known = cost if cost.is_known else self._cost(wish, is_small=False)
        self._resolution.heed(*wish.size, known)
        self._make(wish, self._resolution.size(*wish.size), purpose)

    def _hurry(self, picture: Picture, wish: Wish) -> None:
        """Make a smaller picture first, if the one that is begun takes long."""
        if picture.seconds < _LEAST_SIGN:
            return
        if self._purpose in (_MOVING, _GLANCE):
            self._resolution.heed(*wish.size, self._cost(wish, is_small=True))
            width, height = self._resolution.size(*wish.size)
            is_large = 2 * width * height < picture.width * picture.height
            if is_large and picture.seconds_left > _SOON:
                self._begin_small(wish, self._purpose)
            return
        is_first = self._whole is None and self._seen != wish.sight
        if is_first and picture.seconds_left > _PATIENCE:
            self._begin_small(wish, _GLANCE)

    def _is_complete(self, wish: Wish) -> bool:
        whole = self._whole
        return whole is not None and whole.samples >= wish.settings.target_samples

    def _cost(self, wish: Wish, *, is_small: bool) -> Cost:
        settings = wish.settings
        what = wish.prepared.key, settings.mode, settings.max_bounces, is_small
        if len(self._costs) >= _MOST_COSTS:
            self._costs.clear()
        return self._costs.setdefault(what, Cost())

    def _make(self, wish: Wish, size: tuple[int, int], purpose: int) -> None:
        """Begin a picture."""
        settings, cost = wish.settings, self._cost(wish, is_small=purpose in (_MOVING, _GLANCE))
        setting = replace(wish.prepared.setting, options=settings.mode_options)
        setting = setting.seen_by(wish.camera, size)
        samples = settings.target_samples if purpose == _SAMPLES else 1
        self._purpose = purpose
        if settings.heatmap is not None:
            self._picture = HeatPicture(centered(setting), settings.heatmap, cost)
        else:
            setting = spread(setting, samples)
            self._picture = SampledPicture(RENDERERS[settings.mode], setting, cost)

    def _finish(self, picture: Picture, wish: Wish) -> None:
        """Show a picture that has one more sample."""
        now = time.perf_counter()
        is_first = self._seen != wish.sight
        self._seen = wish.sight
        if self._purpose in (_MOVING, _GLANCE):
            self._picture = None
            if self._purpose == _MOVING:
                self._note_frame(picture, wish, now)
            if (picture.width, picture.height) == wish.size:
                self._whole = picture
            self._send(picture, wish, may_drop=False)
            return
        self._awaited_at = None
        if picture.is_done:
            self._picture = None
        if self._whole is None or picture.samples > 1:
            is_first = is_first or self._whole is None
            self._whole = picture
            is_due = now - self._sent_at >= pause_after(now - self._rested_at)
            if is_first or picture.is_done or is_due:
                self._send(picture, wish, may_drop=not (is_first or picture.is_done))

    def _note_frame(self, picture: Picture, wish: Wish, now: float) -> None:
        """Take in how long a picture of a moving camera took, from the one before."""
        if self._awaited_at is not None:
            pixels = picture.width * picture.height
            self._resolution.note(*wish.size, pixels, now - self._awaited_at)
        self._awaited_at = None
        self._rate.note(now)

    def _send(self, picture: Picture, wish: Wish, *, may_drop: bool) -> None:
        count = picture.samples
        if count > 1 and (count & (count - 1) == 0 or picture.is_done):
            self._noise = picture.noise()
        self._told = _tale(wish, picture)
        self._sent_at = time.perf_counter()
        look = wish.settings.look
        self._show(Shot(picture.draw(look), self.header(picture, wish)), may_drop)


def _tale(wish: Wish, picture: Picture | None) -> tuple[Any, ...]:
    """What a page has been told of a complete picture, once it is shown."""
    return wish.settings.look, wish.number, wish.moving, id(picture)
