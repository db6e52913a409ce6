"""About: on what machine, with which command and when results were measured."""

from __future__ import annotations

from typing import Any, NamedTuple

__all__ = ["About"]


class About(NamedTuple):
    """What a reader of a report has to know.

    Attributes
    ----------
    command : str
        That measures everything again.
    machine : dict of str to Any
        See `bench.machine.describe_machine`.
    version, source : str
        Of raystream; a hash of its sources.
    date : str
        ISO 8601.
    foreign_count : int
        Measurements that were taken over from another source.
    quick : bool
    """

    command: str
    machine: dict[str, Any]
    version: str
    source: str
    date: str
    foreign_count: int
    quick: bool

    def command_for(self, experiment: str) -> str:
        """The command that measures one experiment again."""
        paper, _, name = experiment.partition("-")
        words = self.command.split(" ")
        start = words.index("lab") + 1
        while start < len(words) and not words[start].startswith("-"):
            del words[start]
        words[start:start] = [paper, "--only", name]
        return " ".join(words)

    def lines(self) -> list[str]:
        """A sentence each."""
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
        if self.quick:
            lines.append(
                "Quick: small scenes, pictures and sweeps, to see that all experiments work. The "
                "figures are not to be compared with the papers'."
            )
        if self.foreign_count:
            lines.append(
                f"{self.foreign_count} measurements were taken over from a run of another source "
                "of raystream."
            )
        return lines
