"""Settings: what a visitor asks to see, apart from the scene, the camera and the canvas."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

from raystream.machines.schedulers import SCHEDULERS
from raystream.rendering.heatmap import HEATMAPS
from raystream.rendering.picture import RENDERERS
from raystream.rendering.sampled import MAX_BOUNCES
from raystream.rendering.tone import TONES
from raystream.structures import STRUCTURES
from raystream.viewer.messages import (
    Message,
    MessageError,
    read_choice,
    read_number,
    read_whole,
)

__all__ = [
    "MACHINES",
    "MAX_SAMPLES",
    "Look",
    "Settings",
    "TracerKey",
    "traversals_of",
]

#: Machines by device, the usual one first; here because to ask a device is to import it.
MACHINES: dict[str, tuple[str, ...]] = {
    "cpu": ("branching", "multipass"),
    "graphics": ("compute", "branching", "multipass"),
    "cuda": ("branching", "multipass"),
}

#: Most samples of a pixel that can be asked for.
MAX_SAMPLES = 4096

#: Samples of a pixel without more being asked for: of modes that draw numbers for more than
#: the place in the pixel, and of the others.
_MANY_SAMPLES, _FEW_SAMPLES = 64, 16
_NOISY = ("path", "kajiya", "ao")


def traversals_of(structure: str) -> tuple[str, ...]:
    """The ways to search a structure, the default first; none where there is no choice."""
    return STRUCTURES[structure].choices("traversal")


def _all_traversals() -> tuple[str, ...]:
    return tuple(dict.fromkeys(one for name in STRUCTURES for one in traversals_of(name)))


class TracerKey(NamedTuple):
    """What tells the tracers of one scene apart."""

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


class Look(NamedTuple):
    """What changes how samples are shown, and not the samples."""

    exposure: float
    tone: str
    maximum: float | None


@dataclass(frozen=True)
class Settings:
    """What a visitor asks to see.

    Attributes
    ----------
    mode, structure, device, tone : str
        Names that `raystream.render` takes.
    traversal, machine, scheduler : str, optional
        None takes the usual one, also where there is no choice.
    max_bounces : int, optional
        For modes that have it; None takes the mode's own.
    exposure : float
        Factor on the light, above 0.
    heatmap : str, optional
        Show what rays cost instead of the mode's picture; see `HEATMAPS`.
    maximum : float, optional
        Top of the heat map's scale; None takes the largest count of a pixel.
    samples : int, optional
        Samples of a pixel at which a picture is done; None takes what suits the mode.
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
        """The settings with those that a message names.

        What depends on another one goes back to the usual with it: a traversal with its
        structure, a machine with its device, a scheduler with its machine.

        Raises
        ------
        MessageError
            If a value is no such setting, or does not go with the others.
        """
        given = {name: message[name] for name in _READERS if name in message}
        unknown = [name for name in message if name not in _READERS and name != "type"]
        if unknown:
            raise MessageError(f"{unknown[0]!r:.40}: there is no such setting")
        read: dict[str, Any] = {
            name: None if value is None and name in _OPTIONAL else _READERS[name](given)
            for name, value in given.items()
        }
        for name, depends in _DEPENDS.items():
            if any(one in read and read[one] != getattr(self, one) for one in depends):
                read.setdefault(name, None)
        made = replace(self, **read)
        made._check_together()
        _ = made.mode_options  # which checks them
        return made

    def _check_together(self) -> None:
        traversals = traversals_of(self.structure)
        if self.traversal is not None and self.traversal not in traversals:
            has = f"has {', '.join(traversals)}" if traversals else "has no choice of them"
            raise MessageError(f"traversal: {self.structure} {has}, got {self.traversal!r}")
        machines = MACHINES[self.device]
        if self.machine is not None and self.machine not in machines:
            known = ", ".join(machines)
            raise MessageError(f"machine: device {self.device} has {known}, got {self.machine!r}")
        if self.scheduler is not None and self.machine != "multipass":
            raise MessageError("scheduler: only with machine multipass")

    @property
    def tracer_key(self) -> TracerKey:
        """The tracer that it needs, with the names of what is usual."""
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
    def look(self) -> Look:
        """How samples are shown."""
        return Look(self.exposure, self.tone, self.maximum)

    @property
    def mode_options(self) -> Mapping[str, Any]:
        """Options of the mode, as its stages take them."""
        return RENDERERS[self.mode].check(self._named_options)

    @property
    def _named_options(self) -> dict[str, Any]:
        """The same as `raystream.render` takes them."""
        options = dict(RENDERERS[self.mode].options)
        if self.max_bounces is not None and "max_bounces" in options:
            options["max_bounces"] = self.max_bounces
        return options

    @property
    def target_samples(self) -> int:
        """Samples of a pixel at which the picture is done."""
        if self.heatmap is not None:
            return 1
        if self.samples is not None:
            return self.samples
        return _MANY_SAMPLES if self.mode in _NOISY else _FEW_SAMPLES

    def message(self) -> Message:
        """All of them as they are in effect, and what can be chosen with them."""
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


#: How each setting is read; those of `_OPTIONAL` may be null.
_READERS: dict[str, Callable[[Mapping[str, Any]], Any]] = {
    "mode": lambda given: read_choice(given, "mode", RENDERERS),
    "structure": lambda given: read_choice(given, "structure", STRUCTURES),
    "traversal": lambda given: read_choice(given, "traversal", _all_traversals()),
    "machine": lambda given: read_choice(given, "machine", MACHINES["graphics"]),
    "scheduler": lambda given: read_choice(given, "scheduler", SCHEDULERS),
    "device": lambda given: read_choice(given, "device", MACHINES),
    "max_bounces": lambda given: read_whole(given, "max_bounces", 0, MAX_BOUNCES),
    "exposure": lambda given: read_number(given, "exposure", 0.0, 1e9, above=True),
    "tone": lambda given: read_choice(given, "tone", TONES),
    "heatmap": lambda given: read_choice(given, "heatmap", HEATMAPS),
    "maximum": lambda given: read_number(given, "maximum", 0.0, 1e9, above=True),
    "samples": lambda given: read_whole(given, "samples", 1, MAX_SAMPLES),
}
_OPTIONAL = (
    "traversal",
    "machine",
    "scheduler",
    "max_bounces",
    "heatmap",
    "maximum",
    "samples",
)

#: What goes back to the usual where another setting changes.
_DEPENDS = {
    "traversal": ("structure",),
    "machine": ("device",),
    "scheduler": ("machine", "device"),
}
