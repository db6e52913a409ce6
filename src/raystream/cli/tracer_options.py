"""Options that choose how rays are traced: structure, machine, device, and ``KEY=VALUE``."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from raystream.cli import options
from raystream.cli.console import BadInputError
from raystream.core.choices import MACHINES, SCHEDULERS
from raystream.core.errors import RaystreamError
from raystream.structures import STRUCTURES
from raystream.structures.kdtree.options import TRAVERSALS


@dataclass(frozen=True)
class TracerArguments:
    """Checked arguments of `Tracer`.

    Attributes
    ----------
    structure : str or None
        None: that of a saved structure, else ``"bvh"``.
    device : str
    options : dict
        Options of the structure, the machine and the device.
    """

    structure: str | None
    device: str
    options: dict[str, Any]

    def keywords(self) -> dict[str, Any]:
        """Return the keyword arguments of a new `Tracer`."""
        return {"structure": self.structure or "bvh", "device": self.device, **self.options}

    def figures(self) -> dict[str, Any]:
        """Describe the execution for ``--json``: ``machine``, ``device``, ``scheduler``."""
        machine = self.options.get("machine", options.DEFAULT_MACHINES[self.device])
        figures = {"machine": machine, "device": self.device}
        if machine == "multipass":
            figures["scheduler"] = self.options.get("scheduler", SCHEDULERS[0])
        return figures

    @contextlib.contextmanager
    def blamed(self) -> Iterator[None]:
        """Turn a tracer's errors about these options into `BadInputError`.

        Without options, such errors are bugs and pass through unchanged.
        """
        try:
            yield
        except RaystreamError:
            raise
        except (ValueError, TypeError) as error:
            if not self.options:
                raise
            has_flag = str(error).partition(":")[0] in TracerOptions.__dataclass_fields__
            raise BadInputError(f"--{error}" if has_flag else f"--option: {error}") from error


@dataclass(frozen=True)
class TracerOptions:
    """Options of a command that builds a `Tracer`."""

    structure: Annotated[
        str | None,
        options.choice(
            STRUCTURES, f"Acceleration structure: {' or '.join(STRUCTURES)} [default: bvh]"
        ),
    ] = None
    traversal: Annotated[
        str | None,
        options.choice(
            TRAVERSALS, f"kd-tree traversal: {' or '.join(TRAVERSALS)} [default: {TRAVERSALS[0]}]"
        ),
    ] = None
    machine: Annotated[
        str | None,
        options.choice(
            MACHINES,
            "Execution model: branching runs each ray from start to end; multipass advances all "
            "rays one step per pass (not on cuda); compute runs each ray in a compute shader "
            "(--device graphics only) [default: branching; on graphics, compute]",
        ),
    ] = None
    scheduler: Annotated[
        str | None,
        options.choice(
            SCHEDULERS,
            "With --machine multipass: selects the rays of each pass, "
            f"{' or '.join(SCHEDULERS)} [default: {SCHEDULERS[0]}]",
        ),
    ] = None
    option: Annotated[
        list[str] | None,
        options.value(
            "KEY=VALUE",
            "An option of the structure or the machine, such as resolution=50, quality=fast "
            "or threshold=0.3. Repeatable.",
        ),
    ] = None
    device: Annotated[
        str,
        options.choice(
            options.DEVICES,
            "Device that traces rays: cpu; graphics, any GPU through Vulkan, Metal or Direct3D "
            "12; or cuda, an NVIDIA GPU (see raystream info --devices).",
        ),
    ] = "cpu"
    adapter: Annotated[
        str | None,
        options.value(
            "NAME",
            "With --device graphics: part of the adapter's name [default: RAYSTREAM_ADAPTER, "
            "else the best one]",
        ),
    ] = None
    gpu: Annotated[
        int | None,
        options.count("With --device cuda: the GPU's CUDA device number [default: 0]", least=0),
    ] = None

    def arguments(self) -> TracerArguments:
        """Combine the options with those of ``--option``.

        Raises
        ------
        BadInputError
            If they contradict each other, or a key has an option of its own.
        """
        parsed = parse_keywords("--option", self.option or [])
        for key in ("structure", "device"):
            if key in parsed:
                raise BadInputError(f"--option: pass {key} with --{key}")
        for key in ("adapter", "gpu", "traversal", "machine", "scheduler"):
            value = getattr(self, key)
            if value is not None and parsed.setdefault(key, value) != value:
                raise BadInputError(f"--option: {key} differs from --{key}")
        if self.scheduler is not None and parsed.get("machine") != "multipass":
            raise BadInputError("--scheduler: only with --machine multipass")
        if self.adapter is not None and self.device != "graphics":
            raise BadInputError("--adapter: only with --device graphics")
        if self.gpu is not None and self.device != "cuda":
            raise BadInputError("--gpu: only with --device cuda")
        return TracerArguments(self.structure, self.device, parsed)


def parse_keywords(where: str, words: Sequence[str]) -> dict[str, Any]:
    """Parse ``key=value`` pairs; a value is a number, a list, true, false or null, else text.

    Raises
    ------
    BadInputError
        If a word is not such a pair, or its key cannot be set on the command line.
    """
    parsed: dict[str, Any] = {}
    for word in words:
        key, equals, value = word.strip().partition("=")
        if not equals or not key.isidentifier():
            raise BadInputError(f"{where}: expected KEY=VALUE, got {word!r}")
        if key in ("scene", "progress"):
            raise BadInputError(f"{where}: {key} cannot be set")
        try:
            parsed[key] = json.loads(value)
        except (ValueError, RecursionError):
            parsed[key] = value
    return parsed
