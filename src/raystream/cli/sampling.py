"""Sampling options of ``raystream render``, and their translation for each mode."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from raystream.cli import options
from raystream.cli.console import BadInputError

if TYPE_CHECKING:
    from raystream.rendering.integrator import Integrator

#: Maximum samples when noise or time decide, and no number is given.
MAX_SAMPLES = 1 << 16


class Quality(NamedTuple):
    """What ``--quality`` stands for.

    Attributes
    ----------
    samples : int
        Most paths per pixel, of modes with noise.
    noise, seconds : float or None
        Other limits.
    is_denoised : bool
    few : int
        Paths per pixel of modes without noise, for smooth edges.
    """

    samples: int
    noise: float | None
    seconds: float | None
    is_denoised: bool
    few: int


QUALITIES = {
    "preview": Quality(64, 0.03, 1.25, True, 4),
    "good": Quality(1024, 0.01, None, True, 16),
    "final": Quality(MAX_SAMPLES, 0.003, None, False, 64),
}

#: Modes whose light is estimated by random paths.
NOISY = ("kajiya", "path")


@dataclass(frozen=True)
class SamplingOptions:
    """Options of the samples of an image."""

    quality: Annotated[
        str | None,
        options.choice(
            tuple(QUALITIES),
            "preview takes a second and is denoised; good is denoised at a noise of 1 %; final "
            "has a noise of 0.3 % [default: preview, unless one of the next three is given]",
        ),
    ] = None
    samples: Annotated[
        int | None,
        options.count(
            f"Paths per pixel [default: with --noise or --time-limit at most {MAX_SAMPLES:,}]"
        ),
    ] = None
    noise: Annotated[
        float | None,
        options.positive_number(
            "X",
            "Stop once the estimated relative error of the image falls below X; 0.01 is one "
            "per cent.",
        ),
    ] = None
    time_limit: Annotated[
        float | None,
        options.positive_number("SECONDS", "End at the sample nearest to this many seconds."),
    ] = None
    max_bounces: Annotated[
        int | None,
        options.count(
            "Modes whitted, kajiya and path: maximum number of bounces [default: 8, 3 and 8]",
            least=0,
        ),
    ] = None
    preset: Annotated[
        str | None,
        options.value(
            "NAME",
            "Mode path: a set of options; arnold is Purcell's path tracer, with two diffuse "
            "bounces and no samples of lights.",
        ),
    ] = None
    sampler: Annotated[
        str | None,
        options.choice(
            options.SAMPLERS,
            f"Sampler: {' or '.join(options.SAMPLERS)} [default: {options.SAMPLERS[0]}]",
        ),
    ] = None
    seed: Annotated[
        int,
        options.count(
            "Seed of the sampler: the same seed gives the same image.", least=0, most=(1 << 32) - 1
        ),
    ] = 0


def mode_arguments(mode: str, sampling: SamplingOptions, chosen: dict[str, Any]) -> dict[str, Any]:
    """Collect the arguments of `raystream.render` for a mode.

    Parameters
    ----------
    mode : str
    sampling : SamplingOptions
    chosen : dict
        Parsed ``--option`` values; the mode's own options are removed from it.

    Returns
    -------
    dict
        Keyword arguments, without ``resume``.

    Raises
    ------
    BadInputError
        If the mode does not accept a given option, or a value is out of range.
    """
    from raystream.rendering.render import RENDERERS

    given = _own_options(mode, sampling, chosen, RENDERERS)
    _check_own(RENDERERS[mode], given, sampling)
    return {**given, **_sample_arguments(mode, sampling)}


def is_denoised(mode: str, sampling: SamplingOptions) -> bool:
    """Whether the quality asks for a denoised image."""
    quality = _quality(sampling)
    return quality is not None and quality.is_denoised and mode in NOISY


def tells_error(mode: str, sampling: SamplingOptions) -> bool:
    """Whether the error is told: in a mode with noise, or if it was asked for.

    Otherwise it is that of smooth edges, large where nothing looks wrong.
    """
    return mode in (*NOISY, "ao") or sampling.noise is not None


def is_preview(sampling: SamplingOptions) -> bool:
    """Whether a few seconds count for more than the last of the noise."""
    return _quality(sampling) is QUALITIES["preview"]


def _quality(sampling: SamplingOptions) -> Quality | None:
    """The quality that is asked for, or the default one; None if samples or limits are given."""
    limits = {
        "samples": sampling.samples,
        "noise": sampling.noise,
        "time-limit": sampling.time_limit,
    }
    given = [name for name, value in limits.items() if value is not None]
    if given and sampling.quality is not None:
        raise BadInputError(f"--quality: cannot be combined with --{given[0]}")
    return None if given else QUALITIES[sampling.quality or "preview"]


def _only_with(what: str, modes: Mapping[str, Any]) -> BadInputError:
    return BadInputError(f"{what}: only with --mode {' or '.join(modes)}")


def _own_options(
    mode: str,
    sampling: SamplingOptions,
    chosen: dict[str, Any],
    renderers: Mapping[str, Integrator],
) -> dict[str, Any]:
    """Take the modes' options out of `chosen`; reject those of other modes."""
    owners: dict[str, dict[str, Integrator]] = {}
    for renderer in renderers.values():
        for name in renderer.options:
            owners.setdefault(name, {})[renderer.name] = renderer
    given = {}
    for name in [name for name in chosen if name in owners]:
        if mode not in owners[name]:
            raise _only_with(f"--option: {name}", owners[name])
        default = owners[name][mode].options[name]
        given[name] = _converted(f"--option: {name}", chosen.pop(name), default)
    if sampling.max_bounces is not None:
        if mode not in owners["max_bounces"]:
            raise _only_with("--max-bounces", owners["max_bounces"])
        if given.setdefault("max_bounces", sampling.max_bounces) != sampling.max_bounces:
            raise BadInputError("--option: max_bounces differs from --max-bounces")
    if sampling.preset is not None:
        given["preset"] = sampling.preset
    return given


def _converted(where: str, value: Any, default: Any) -> Any:
    """Convert a value to the type of its default; infinity arrives as text."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if isinstance(default, bool):
        kind, is_right = "true or false", isinstance(value, bool)
    elif isinstance(default, int):
        kind, is_right = "an integer", is_number and isinstance(value, int)
    elif isinstance(default, str):
        kind, is_right = "a name", isinstance(value, str)
    else:
        kind, is_right = "a number", is_number or value == "inf"
    if not is_right:
        raise BadInputError(f"{where}: expected {kind}, got {value!r}")
    try:
        return float(value) if default is None else type(default)(value)
    except OverflowError:
        raise BadInputError(f"{where}: is too large") from None


def _check_own(renderer: Integrator, given: Mapping[str, Any], sampling: SamplingOptions) -> None:
    try:
        renderer.check(renderer.complete(given))
    except ValueError as error:
        name, _, reason = str(error).partition(": ")
        by_name = name == "max_bounces" and sampling.max_bounces is not None
        if name == "preset":
            raise BadInputError(f"--{error}") from error
        raise BadInputError(
            f"--max-bounces: {reason}" if by_name else f"--option: {error}"
        ) from error


def _sample_arguments(mode: str, sampling: SamplingOptions) -> dict[str, Any]:
    from raystream.rendering.sampling.sampler import Sampler

    sampler = sampling.sampler or options.SAMPLERS[0]
    noise, seconds, samples = sampling.noise, sampling.time_limit, sampling.samples
    quality = _quality(sampling)
    if quality is not None and mode in NOISY:
        samples, noise, seconds = quality.samples, quality.noise, quality.seconds
    elif quality is not None:
        samples = quality.few
    elif samples is None and sampler == "stratified":
        raise BadInputError("--sampler: stratified needs --samples, to stratify each pixel")
    samples = samples or MAX_SAMPLES
    try:
        Sampler.of(sampler, sampling.seed, samples)
    except ValueError as error:  # argument names equal option names
        raise BadInputError(f"--{error}") from error
    return {
        "samples": samples,
        "seed": sampling.seed,
        "sampler": sampler,
        "noise": noise,
        "time_limit": seconds,
    }
