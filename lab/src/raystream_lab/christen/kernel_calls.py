"""Passes of the multipass machine for each bounce, and the records masked out in them."""

from __future__ import annotations

from typing import Any

from raystream.scene.scene import Scene
from raystream.tracer import Tracer
from raystream_lab.christen.scenes import (
    MATTE_BASE,
    SCENES,
    TEAPOT,
    Bounce,
    bounces_of,
    christen_scene,
    image_size,
)
from raystream_lab.frame_timing import report_image
from raystream_lab.published import published
from raystream_lab.results import Cell, Claim, Plot, Result, Series, Table
from raystream_lab.runner import Runner
from raystream_lab.threshold_rule import threshold_claim

#: The scenes whose calls are counted.
LETTERS = (*SCENES, TEAPOT, MATTE_BASE)

ITERATIONS = 8
_QUICK_ITERATIONS = 5

#: Shares of waiting rays at which an intersection pass starts.
THRESHOLDS = (0.01, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.7, 0.9)
_QUICK_THRESHOLDS = (0.05, 0.2, 0.5)

#: Iterations summed in the sweep, and the divisor of its image's width.
_SWEPT_ITERATIONS = 3
_SWEEP_SHARE = 2

#: Our reading of "few", as a share of an image's pixels.
FEW = 0.1

_Passes = dict[str, Any]


def kernel_calls(runner: Runner) -> Result:
    """Passes and masked records by kernel and bounce, and a sweep of the threshold."""
    result = Result()
    found: dict[str, list[_Passes]] = {}
    sweeps: dict[str, dict[str, int]] = {}
    for letter in LETTERS:
        scene = christen_scene(letter)
        found[letter] = _measured(runner, scene, letter)
        sweeps[letter] = _swept(runner, scene, letter)
        title = f"Scene {letter}"
        result.images.append(
            report_image(runner, f"christen {letter} eye", title, scene, "raycast", (256, 256))
        )
    pixels = image_size(runner) ** 2
    result.tables = [
        _iterations_table(found, pixels),
        _kernels_table(found, pixels),
        _sweep_table(runner, sweeps),
    ]
    result.plots = [*_plots(found, pixels), _sweep_plot(sweeps)]
    result.claims = [
        _few(found, pixels),
        _more_passes(found),
        _inefficient(found),
        _threshold(sweeps),
    ]
    return result


def passes_of(
    scene: Scene, bounce: Bounce, threshold: float, resolution: int, progress: Any = None
) -> _Passes:
    """Trace a bounce's rays on the multipass machine.

    Parameters
    ----------
    scene : Scene
    bounce : Bounce
    threshold : float
        Share of active rays that must wait for a test.
    resolution : int
        Cells of the grid along each axis.
    progress : callable, optional

    Returns
    -------
    dict
        ``rays``, ``light_rays``; ``passes`` and their lower bound, ``optimal``; ``kernels``: by
        name the passes, the records that they ran on, and the records masked out.
    """
    tracer = Tracer(
        scene,
        "grid",
        machine="multipass",
        counters=True,
        threshold=threshold,
        resolution=resolution,
    )
    tracer.first_hit(bounce.origins, bounce.directions, progress=progress)
    passes = tracer.counters.passes
    assert passes is not None
    kernels: dict[str, list[int]] = {}
    for one in passes:
        counts = kernels.setdefault(one.kernel, [0, 0, 0])
        counts[0] += 1
        counts[1] += one.run_count
        counts[2] += one.record_count - one.run_count
    return {
        "iteration": bounce.iteration,
        "rays": len(bounce.directions),
        "light_rays": bounce.light_ray_count,
        "passes": len(passes),
        "optimal": passes.optimal_count,
        "kernels": kernels,
    }


def _resolution() -> int:
    return int(published("christen", "settings").values["resolution"])


def _measured(runner: Runner, scene: Scene, letter: str) -> list[_Passes]:
    """Passes of each bounce of an image."""
    threshold = published("christen", "scheduling").values["threshold"]

    def measure() -> list[_Passes]:
        count = _QUICK_ITERATIONS if runner.quick else ITERATIONS
        return [
            passes_of(scene, one, threshold, _resolution(), runner.progress)
            for one in bounces_of(scene, image_size(runner), count)
        ]

    values: list[_Passes] = runner.measure(f"{letter}, bounces", measure)
    return values


def _swept(runner: Runner, scene: Scene, letter: str) -> dict[str, int]:
    """Total passes of the first bounces, by threshold."""
    size = image_size(runner) // _SWEEP_SHARE
    bounces: list[Bounce] = []
    sweep = {}
    for threshold in _QUICK_THRESHOLDS if runner.quick else THRESHOLDS:

        def measure(threshold: float = threshold) -> int:
            if not bounces:
                bounces.extend(bounces_of(scene, size, _SWEPT_ITERATIONS))
            each = [passes_of(scene, one, threshold, _resolution()) for one in bounces]
            return sum(one["passes"] for one in each)

        sweep[f"{threshold:g}"] = runner.measure(f"{letter}, threshold {threshold:g}", measure)
    return sweep


def _runs(one: _Passes) -> int:
    return sum(runs for _, runs, _ in one["kernels"].values())


def _masked(one: _Passes) -> int:
    return sum(masked for _, _, masked in one["kernels"].values())


def _idle(one: _Passes, pixels: int) -> float:
    """Share of an image's pixels that passes masked out, over all passes."""
    return 1.0 - _runs(one) / (one["passes"] * pixels)


def _iterations_table(found: dict[str, list[_Passes]], pixels: int) -> Table:
    rows: list[list[Cell]] = []
    for letter, bounces in found.items():
        rays = sum(one["rays"] for one in bounces)
        passes = sum(one["passes"] for one in bounces)
        rows += [
            [
                letter,
                one["iteration"],
                one["rays"],
                one["rays"] / pixels,
                one["passes"],
                one["optimal"],
                one["rays"] / rays,
                one["passes"] / passes,
                one["passes"] * pixels - _runs(one),
                _idle(one, pixels),
                _masked(one) / (_masked(one) + _runs(one)),
                one["light_rays"],
            ]
            for one in bounces
        ]
    return Table.of(
        "christen-iterations",
        f"Active rays at each iteration, and their kernel calls; {pixels:,} pixels, "
        f"{_resolution()}³ cells",
        ["scene", "iteration", "rays", "of pixels", "passes", "at least", "of all rays"]
        + ["of all passes", "rejected early", "lanes idle", "idle, own rays only", "shadow rays"],
        rows,
        "Passes are kernel calls. Rejected early: pixels masked out, as by early z culling, summed "
        "over passes; lanes idle: their share of all pixels. Christen's textures always hold all "
        "pixels; ours hold only the rays of an iteration, as the next column assumes. Each call "
        "needs another pass to set depths, which is not counted.",
        "Shadow rays are not included, since Christen's renderer has none.",
    )


def _kernels_table(found: dict[str, list[_Passes]], pixels: int) -> Table:
    rows: list[list[Cell]] = [
        [letter, one["iteration"], kernel, count, runs, count * pixels - runs, masked]
        for letter, bounces in found.items()
        for one in bounces
        for kernel, (count, runs, masked) in one["kernels"].items()
    ]
    return Table.of(
        "christen-kernels",
        "The same by kernel",
        ["scene", "iteration", "kernel", "passes", "records run on", "rejected, of all pixels"]
        + ["rejected, of own rays"],
        rows,
    )


def _sweep_table(runner: Runner, sweeps: dict[str, dict[str, int]]) -> Table:
    size = image_size(runner) // _SWEEP_SHARE
    names = list(next(iter(sweeps.values())))
    return Table.of(
        "christen-thresholds",
        f"Kernel calls against the share of waiting rays that starts an intersection pass, {size} "
        f"x {size} pixels, {_SWEPT_ITERATIONS} iterations",
        ["scene", *names],
        [[letter, *sweep.values()] for letter, sweep in sweeps.items()],
    )


def _plots(found: dict[str, list[_Passes]], pixels: int) -> list[Plot]:
    parts = {
        "rays": ("Active rays", "share of pixels", lambda one: one["rays"] / pixels),
        "passes": ("Kernel calls", "passes", lambda one: float(one["passes"])),
    }
    return [
        Plot(
            f"christen-{part}",
            f"{title} at each iteration",
            "iteration",
            label,
            [
                Series(letter, [one["iteration"] for one in each], [value(one) for one in each])
                for letter, each in found.items()
            ],
            log_y=True,
        )
        for part, (title, label, value) in parts.items()
    ]


def _sweep_plot(sweeps: dict[str, dict[str, int]]) -> Plot:
    return Plot(
        "christen-thresholds",
        "Kernel calls against the share of waiting rays that starts an intersection pass",
        "share",
        "passes, of the fewest",
        [
            Series(
                letter,
                [float(share) for share in sweep],
                [count / min(sweep.values()) for count in sweep.values()],
            )
            for letter, sweep in sweeps.items()
        ],
    )


def _late(bounces: list[_Passes]) -> list[_Passes]:
    depth = published("christen", "observations").values["few_rays_from_depth"]
    return [one for one in bounces if one["iteration"] >= depth]


def _few(found: dict[str, list[_Passes]], pixels: int) -> Claim:
    source = published("christen", "observations")
    depth = source.values["few_rays_from_depth"]
    shares = {
        letter: max((one["rays"] for one in _late(each)), default=0) / pixels
        for letter, each in found.items()
    }
    return Claim.judged(
        f"from iteration {depth}, only a few rays are active (read as: at most {FEW:.0%} of the "
        "pixels)",
        source.source,
        {letter: share <= FEW for letter, share in shares.items()},
        "; ".join(f"{letter}: {share:.2%}" for letter, share in shares.items())
        + "; in ours, all surfaces of A and a third of B's cubes are mirrors; which of his were is "
        "not known",
    )


def _more_passes(found: dict[str, list[_Passes]]) -> Claim:
    ratios = {
        letter: sum(one["passes"] for one in each[:5]) / each[0]["passes"]
        for letter, each in found.items()
    }
    return Claim.judged(
        "more iterations take many more passes (read as: five take more than twice those of one)",
        published("christen", "observations").source,
        {letter: ratio > 2.0 for letter, ratio in ratios.items()},
        "; ".join(f"{letter}: {ratio:.2f} times" for letter, ratio in ratios.items()),
    )


def _inefficient(found: dict[str, list[_Passes]]) -> Claim:
    source = published("christen", "observations")
    shares = {}
    for letter, each in found.items():
        late = _late(each)
        if not late:
            continue
        shares[letter] = tuple(
            sum(one[key] for one in late) / sum(one[key] for one in each)
            for key in ("passes", "rays")
        )
    return Claim.judged(
        f"passes for the few rays from iteration {source.values['few_rays_from_depth']} are "
        "inefficient: their share of all passes is larger than their share of all rays",
        source.source,
        {letter: passes > rays for letter, (passes, rays) in shares.items()},
        "; ".join(
            f"{letter}: {passes:.1%} of passes for {rays:.2%} of rays"
            for letter, (passes, rays) in shares.items()
        ),
    )


def _threshold(sweeps: dict[str, dict[str, int]]) -> Claim:
    source = published("christen", "scheduling")
    return threshold_claim(
        source.source,
        source.values["threshold"],
        {
            letter: {float(share): count for share, count in sweep.items()}
            for letter, sweep in sweeps.items()
        },
    )
