"""Views: the cameras of a scene, and the selected one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from raystream.scene.camera import Camera
from raystream.scene.camera_track import CameraMotion


@dataclass(frozen=True)
class Views:
    """The selected camera of a scene, and those to choose from.

    Attributes
    ----------
    camera : Camera or None
        None to frame the scene.
    track : CameraMotion or None
        Motion of `camera`.
    named : mapping of str to Camera or CameraMotion
    """

    camera: Camera | None
    track: CameraMotion | None
    named: Mapping[str, Camera | CameraMotion]

    @classmethod
    def of(
        cls,
        camera: Camera | str | int | None,
        track: CameraMotion | None,
        named: Mapping[str, Camera | CameraMotion] | None,
    ) -> Views:
        """Choose a view: the camera, else the track's, else the first named one."""
        views = cls(None, track, dict(named or {}))
        if isinstance(camera, str | int):
            return views.choose(camera)
        if camera is None and track is not None:
            camera = track.still
        if camera is None and views.named:
            return views.choose(0)
        return replace(views, camera=camera)

    def choose(self, which: str | int) -> Views:
        """Select one of the named cameras, which may be animated.

        Parameters
        ----------
        which : str or int
            Its name, or its number from 0.

        Raises
        ------
        ValueError
            If there is no such camera.
        """
        names = list(self.named)
        name = names[which] if isinstance(which, int) and 0 <= which < len(names) else which
        if not isinstance(name, str) or name not in self.named:
            shown = ", ".join(f"{name[:40]!r} ({i})" for i, name in enumerate(names[:10]))
            there = f"the scene has {shown}" if names else "the scene has no named cameras"
            raise ValueError(f"no camera {which!r:.60}; {there}")
        one = self.named[name]
        if isinstance(one, Camera):
            return Views(one, None, self.named)
        return Views(one.still, one, self.named)

    def at(self, time: float) -> Views:
        """Return the same views, with the selected camera at a time."""
        return self if self.track is None else replace(self, camera=self.track.at(time))
