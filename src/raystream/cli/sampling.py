"""Samples on the command line: what the modes of ``raystream render`` are asked for."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from raystream.cli import options
from raystream.cli.messages import BadInputError

if TYPE_CHECKING:
    from raystream.rendering.sampled import SampledRenderer

__all__ = [
    "Asked",
    "MaxBounces",
    "Noise",
    "SamplerName",
    "Samples",
    "Seed",
    "TimeLimit",
    "mode_arguments",
]

#: Samples at most where noise or time decide, and no number is given.
MOST_SAMPLES = 1 << 16

Samples = Annotated[
    int | None,
    typer.Option(
        min=1,
        metavar="N",
        show_default=False,
        help="Paths for each pixel; 1 without it, and with --noise or --time-limit at most "
        f"{MOST_SAMPLES:,}.",
    ),
]
Seed = Annotated[
    int,
    typer.Option(
        min=0,
        max=(1 << 32) - 1,
        metavar="N",
        help="For the places of samples: the same seed gives the same picture.",
    ),
]
SamplerName = Annotated[
    str | None,
    typer.Option(
        "--sampler",
        metavar="NAME",
        show_default=False,
        help=f"Where the numbers of samples come from: {' or '.join(options.SAMPLERS)}; "
        f"{options.SAMPLERS[0]} without it.",
        callback=options.one_of(options.SAMPLERS),
        autocompletion=options.complete(options.SAMPLERS),
    ),
]
MaxBounces = Annotated[
    int | None,
    typer.Option(
        min=0,
        metavar="N",
        show_default=False,
        help="Modes whitted, kajiya and path: surfaces that may scatter light on its way; 8, 3 "
        "and 8 without it. Other options of a mode go by --option, such as distance=2 of ao, the "
        "length of its rays: a tenth of the scene's diagonal without it, inf for no end.",
    ),
]
Noise = Annotated[
    float | None,
    typer.Option(
        metavar="X",
        show_default=False,
        callback=options.positive_if_given,
        help="Stop once the estimated relative error of the picture is as small; 0.01 is one "
        "per cent.",
    ),
]
TimeLimit = Annotated[
    float | None,
    typer.Option(
        metavar="SECONDS",
        show_default=False,
        callback=options.positive_if_given,
        help="Take no new sample after so many seconds.",
    ),
]


@dataclass(frozen=True)
class Asked:
    """Options about samples, as given: None for those that were not.

    Attributes
    ----------
    samples : int or None
    seed : int
    max_bounces : int or None
    noise, time_limit : float or None
    sampler : str or None
    resume : bool or None
    """

    samples: int | None
    seed: int
    max_bounces: int | None
    noise: float | None
    time_limit: float | None
    sampler: str | None
    resume: bool | None

    def of_pictures(self) -> dict[str, Any]:
        """Those that only pictures have a use for, not heat maps, by name."""
        return {
            name: value
            for name, value in dataclasses.asdict(self).items()
            if name not in ("samples", "seed")
        }


def mode_arguments(mode: str, asked: Asked, chosen: dict[str, Any]) -> dict[str, Any]:
    """What `raystream.render` is to be given for a mode.

    Parameters
    ----------
    mode : str
    asked : Asked
    chosen : dict
        What ``--option`` was given; the mode's own options are taken out of it.

    Returns
    -------
    dict
        Keyword arguments, without ``resume``.

    Raises
    ------
    BadInputError
        If the mode has no use for something that was given, or it is out of range.
    """
    from raystream.rendering.picture import RENDERERS

    given = _own_options(mode, asked, chosen, RENDERERS)
    _check_own(RENDERERS[mode], given, asked)
    return {**given, **_sample_arguments(asked)}


def _only_with(what: str, modes: Mapping[str, Any]) -> BadInputError:
    return BadInputError(f"{what}: only with --mode {' or '.join(modes)}")


def _own_options(
    mode: str, asked: Asked, chosen: dict[str, Any], renderers: Mapping[str, SampledRenderer]
) -> dict[str, Any]:
    """Take the modes' options out of `chosen`; refuse those of other modes."""
    owners: dict[str, dict[str, SampledRenderer]] = {}
    for renderer in renderers.values():
        for name in renderer.options:
            owners.setdefault(name, {})[renderer.name] = renderer
    given = {}
    for name in [name for name in chosen if name in owners]:
        if mode not in owners[name]:
            raise _only_with(f"--option: {name}", owners[name])
        usual = owners[name][mode].options[name]
        given[name] = _like(f"--option: {name}", chosen.pop(name), usual)
    if asked.max_bounces is not None:
        if mode not in owners["max_bounces"]:
            raise _only_with("--max-bounces", owners["max_bounces"])
        if given.setdefault("max_bounces", asked.max_bounces) != asked.max_bounces:
            raise BadInputError("--option: another max_bounces than --max-bounces")
    return given


def _like(where: str, value: Any, usual: Any) -> Any:
    """The value, if it is of the kind of the usual one; infinity comes as text."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if isinstance(usual, bool):
        kind, is_right = "true or false", isinstance(value, bool)
    elif isinstance(usual, int):
        kind, is_right = "an integer", is_number and isinstance(value, int)
    else:
        kind, is_right = "a number", is_number or value == "inf"
    if not is_right:
        raise BadInputError(f"{where}: expected {kind}, got {value!r}")
    try:
        return float(value) if usual is None else type(usual)(value)
    except OverflowError:
        raise BadInputError(f"{where}: is too large") from None


def _check_own(renderer: SampledRenderer, given: Mapping[str, Any], asked: Asked) -> None:
    try:
        renderer.check({**renderer.options, **given})
    except ValueError as error:
        name, _, reason = str(error).partition(": ")
        by_name = name == "max_bounces" and asked.max_bounces is not None
        raise BadInputError(
            f"--max-bounces: {reason}" if by_name else f"--option: {error}"
        ) from error


def _sample_arguments(asked: Asked) -> dict[str, Any]:
    from raystream.rendering.sampling.sampler import Sampler

    is_limited = asked.noise is not None or asked.time_limit is not None
    sampler = asked.sampler or options.SAMPLERS[0]
    if asked.samples is None and is_limited and sampler == "stratified":
        raise BadInputError("--sampler: stratified needs --samples, to divide each pixel by")
    samples = asked.samples or (MOST_SAMPLES if is_limited else 1)
    try:
        Sampler.of(sampler, asked.seed, samples)
    except ValueError as error:  # its names are those of the options
        raise BadInputError(f"--{error}") from error
    return {
        "samples": samples,
        "seed": asked.seed,
        "sampler": sampler,
        "noise": asked.noise,
        "time_limit": asked.time_limit,
    }
