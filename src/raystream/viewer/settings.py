"""Settings: everything that a client can choose, except scene, camera and canvas."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

from raystream.machines.schedulers import SCHEDULERS
from raystream.rendering.heatmap import HEATMAPS
from raystream.rendering.integrator import MAX_BOUNCES
from raystream.rendering.render import RENDERERS
from raystream.rendering.tone import TONES
from raystream.structures import STRUCTURES
from raystream.viewer.messages import (
    Message,
    MessageError,
    read_choice,
    read_integer,
    read_number,
)

#: Machines by device, the default first; listed here because asking a device imports it.
MACHINES: dict[str, tuple[str, ...]] = {
    "cpu": ("branching", "multipass"),
    "graphics": ("compute", "branching", "multipass"),
    "cuda": ("branching",),
}

#: Maximum samples per pixel that can be requested.
MAX_SAMPLES = 4096

#: Default samples per pixel: for noisy modes, and for modes that sample only the position within
#: the pixel.
_MANY_SAMPLES, _FEW_SAMPLES = 64, 16
_NOISY_MODES = ("path", "kajiya", "ao")


def traversals_of(structure: str) -> tuple[str, ...]:
    """Return the traversals of a structure, the default first; empty if it has only one."""
    return STRUCTURES[structure].choices("traversal")


def _all_traversals() -> tuple[str, ...]:
    return tuple(dict.fromkeys(one for name in STRUCTURES for one in traversals_of(name)))


class TracerKey(NamedTuple):
    """Identifies a tracer of a scene."""

    structure: str
    traversal: str | None
    device: str
    machine: str
    scheduler: str | None
    counters: bool

    @property
    def options(self) -> dict[str, Any]:
        """Arguments of `Tracer`."""
        chosen = {name: value for name, value in self._asdict().items() if value is not None}
        if not self.counters:
            del chosen["counters"]
        return chosen


class DisplaySettings(NamedTuple):
    """Settings that affect how samples are displayed, but not the samples."""

    exposure: float
    tone: str
    maximum: float | None


@dataclass(frozen=True)
class Settings:
    """The settings of a client.

    Attributes
    ----------
    mode, structure, device, tone : str
        Names as for `raystream.render`.
    traversal, machine, scheduler : str, optional
        None for the default, and where there is no choice.
    max_bounces : int, optional
        For modes that support it; None for the mode's default.
    exposure : float
        Factor on the radiance, above 0.
    heatmap : str, optional
        Show the cost of rays instead of the mode's image; see `HEATMAPS`.
    maximum : float, optional
        Top of the heat map's scale; None for the largest count of a pixel.
    samples : int, optional
        Target samples per pixel; None for the mode's default.
    """

    mode: str = "raycast"
    structure: str = "bvh"
    traversal: str | None = None
    machine: str | None = None
    scheduler: str | None = None
    device: str = "cpu"
    max_bounces: int | None = None
    exposure: float = 1.0
    tone: str = "linear"
    heatmap: str | None = None
    maximum: float | None = None
    samples: int | None = None

    def changed(self, message: Mapping[str, Any]) -> Settings:
        """Return the settings updated by a message.

        Dependent settings are reset to their defaults: a traversal with its structure, a
        machine with its device, a scheduler with its machine.

        Raises
        ------
        MessageError
            If a setting is unknown, invalid, or conflicts with the others.
        """
        given = {name: message[name] for name in _READERS if name in message}
        unknown = [name for name in message if name not in _READERS and name != "type"]
        if unknown:
            raise MessageError(f"{unknown[0]!r:.40}: is not a setting")
        read: dict[str, Any] = {
            name: None if value is None and name in _OPTIONAL else _READERS[name](given)
            for name, value in given.items()
        }
        for name, depends in _DEPENDS.items():
            if any(one in read and read[one] != getattr(self, one) for one in depends):
                read.setdefault(name, None)
        made = replace(self, **read)
        made._check_together()
        _ = made.mode_options  # validates them
        return made

    def _check_together(self) -> None:
        traversals = traversals_of(self.structure)
        if self.traversal is not None and self.traversal not in traversals:
            has = f"supports {', '.join(traversals)}" if traversals else "has no traversal option"
            raise MessageError(f"traversal: {self.structure} {has}, got {self.traversal!r}")
        machines = MACHINES[self.device]
        if self.machine is not None and self.machine not in machines:
            known = ", ".join(machines)
            raise MessageError(
                f"machine: device {self.device} supports {known}, got {self.machine!r}"
            )
        if self.scheduler is not None and self.machine != "multipass":
            raise MessageError("scheduler: only with machine multipass")

    @property
    def tracer_key(self) -> TracerKey:
        """Key of the tracer for these settings, with defaults filled in."""
        traversals = traversals_of(self.structure)
        machine = self.machine or MACHINES[self.device][0]
        is_multipass = machine == "multipass"
        return TracerKey(
            self.structure,
            (self.traversal or traversals[0]) if traversals else None,
            self.device,
            machine,
            (self.scheduler or SCHEDULERS[0]) if is_multipass else None,
            self.heatmap is not None,
        )

    @property
    def display(self) -> DisplaySettings:
        """How to display samples."""
        return DisplaySettings(self.exposure, self.tone, self.maximum)

    @property
    def mode_options(self) -> Mapping[str, Any]:
        """Options of the mode, in the form its stages use."""
        return RENDERERS[self.mode].check(self._named_options)

    @property
    def _named_options(self) -> dict[str, Any]:
        """Options of the mode, in the form `raystream.render` accepts."""
        options = dict(RENDERERS[self.mode].options)
        if self.max_bounces is not None and "max_bounces" in options:
            options["max_bounces"] = self.max_bounces
        return options

    @property
    def target_samples(self) -> int:
        """Samples per pixel at which the image is complete."""
        if self.heatmap is not None:
            return 1
        if self.samples is not None:
            return self.samples
        return _MANY_SAMPLES if self.mode in _NOISY_MODES else _FEW_SAMPLES

    def message(self) -> Message:
        """Describe the effective settings, and the choices they leave."""
        key = self.tracer_key
        shown = {field.name: getattr(self, field.name) for field in fields(self)}
        shown |= {"traversal": key.traversal, "machine": key.machine, "scheduler": key.scheduler}
        shown["max_bounces"] = self._named_options.get("max_bounces")
        shown["samples"] = self.target_samples
        possible = {
            "traversal": list(traversals_of(self.structure)),
            "machine": list(MACHINES[self.device]),
            "scheduler": list(SCHEDULERS) if key.machine == "multipass" else [],
            "max_bounces": "max_bounces" in RENDERERS[self.mode].options,
            "samples": self.heatmap is None,
        }
        return {"type": "settings", **shown, "possible": possible}


#: Readers of each setting; those of `_OPTIONAL` may be null.
_READERS: dict[str, Callable[[Mapping[str, Any]], Any]] = {
    "mode": lambda given: read_choice(given, "mode", RENDERERS),
    "structure": lambda given: read_choice(given, "structure", STRUCTURES),
    "traversal": lambda given: read_choice(given, "traversal", _all_traversals()),
    "machine": lambda given: read_choice(given, "machine", MACHINES["graphics"]),
    "scheduler": lambda given: read_choice(given, "scheduler", SCHEDULERS),
    "device": lambda given: read_choice(given, "device", MACHINES),
    "max_bounces": lambda given: read_integer(given, "max_bounces", 0, MAX_BOUNCES),
    "exposure": lambda given: read_number(given, "exposure", 0.0, 1e9, above=True),
    "tone": lambda given: read_choice(given, "tone", TONES),
    "heatmap": lambda given: read_choice(given, "heatmap", HEATMAPS),
    "maximum": lambda given: read_number(given, "maximum", 0.0, 1e9, above=True),
    "samples": lambda given: read_integer(given, "samples", 1, MAX_SAMPLES),
}
_OPTIONAL = [field.name for field in fields(Settings) if field.default is None]

#: Settings that are reset when another one changes.
_DEPENDS = {
    "traversal": ("structure",),
    "machine": ("device",),
    "scheduler": ("machine", "device"),
}
