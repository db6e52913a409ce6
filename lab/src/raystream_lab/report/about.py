"""The provenance of a report: command, machine, version and date."""

from __future__ import annotations

import shlex
from typing import Any, NamedTuple


class About(NamedTuple):
    """The provenance of a report.

    Attributes
    ----------
    command : str
        Repeats all measurements.
    machine : dict of str to Any
        See `bench.machine.describe_machine`; and the ``device``, unless it is the CPU.
    version, source : str
        Version of raystream, and the key of the sources that measure, see `source_key`.
    date : str
        ISO 8601.
    foreign_count : int
        Measurements reused from another version of the sources.
    quick : bool
    device : str
        Name of the device that was measured, see `experiments.DEVICES`.
    adapter : str
        The graphics adapter or GPU; empty for the processor.
    """

    command: str
    machine: dict[str, Any]
    version: str
    source: str
    date: str
    foreign_count: int
    quick: bool
    device: str = "cpu"
    adapter: str = ""

    @property
    def device_name(self) -> str:
        """The device in words."""
        return {"cpu": "CPU", "graphics": "graphics device", "cuda": "CUDA GPU"}[self.device]

    def command_for(self, experiment: str) -> str:
        """The command that repeats one experiment."""
        paper, _, name = experiment.partition("-")
        words = shlex.split(self.command)
        start = words.index("lab") + 1
        while start < len(words) and not words[start].startswith("-"):
            del words[start]
        while "--only" in words:
            at = words.index("--only")
            del words[at : at + 2]
        words[start:start] = [paper, "--only", name]
        return shlex.join(words)

    def lines(self) -> list[str]:
        """The provenance as sentences."""
        machine = self.machine
        memory = machine.get("memory")
        parts = [
            str(machine["cpu"]),
            f"{machine['threads']} threads on {machine['cores']} cores",
            *([f"{memory / 2**30:.0f} GiB of memory"] if memory else []),
            str(machine["system"]),
            f"Python {machine['python']}",
            *(f"{name} {machine[name]}" for name in ("numpy", "numba") if machine.get(name)),
        ]
        made = f"raystream {self.version} (source {self.source})"
        lines = [f"Measured by `{self.command}`, {self.date}, {made}.", ", ".join(parts) + "."]
        if self.adapter:
            lines.append(f"Device {self.device}: {self.adapter}.")
        if self.quick:
            lines.append(
                "Quick: small scenes, images and sweeps, as a smoke test. Do not compare the "
                "figures with the papers'."
            )
        if self.foreign_count:
            lines.append(
                f"{self.foreign_count} measurements were reused from another version of the "
                "sources."
            )
        return lines
