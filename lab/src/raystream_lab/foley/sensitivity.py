"""Sensitivity of Table 2 to settings that the paper leaves open."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from raystream.structures.kdtree.structure import KdTreeStructure
from raystream_lab.foley.scenes import (
    SIZE,
    count_states,
    figures_of,
    foley_trees,
    published_figures,
)
from raystream_lab.foley.settings import Setting, settings_of
from raystream_lab.results import NOT_EXPLAINED, TOLERANCE, is_near
from raystream_lab.runner import Runner
from raystream_lab.views import View

__all__ = ["TOLERANCE", "Trial", "distance", "explain_difference", "is_near", "nearest", "sweep"]

#: Image size of the sweep: figures are means, and depend little on the resolution.
_SWEEP_SIZE = SIZE // 4

#: Maximum number of changes named in a reason.
_MOST_REASONS = 3


class Trial(NamedTuple):
    """A setting, and its figures of Table 2.

    Attributes
    ----------
    group, label, time, options
        See `settings.Setting`.
    figures : mapping of str to float
        See `scenes.figures_of`.
    """

    group: str
    label: str
    time: float
    options: Mapping[str, Any]
    figures: Mapping[str, float]

    @property
    def name(self) -> str:
        """Group and label."""
        return f"{self.group}: {self.label}"


class _TreeCache:
    """Keeps the tree of the last setting, which several settings share."""

    def __init__(self, runner: Runner, view: View) -> None:
        self.runner, self.view = runner, view
        self.key: object = None
        self.trees: dict[str, KdTreeStructure] = {}

    def figures(self, setting: Setting, size: int) -> dict[str, float]:
        scene = self.view.scene
        if setting.time != 0.0:
            scene = scene.at(setting.time)
        if self.key != setting.tree:
            self.trees = foley_trees(scene, self.runner.progress, **setting.options)
            self.key = setting.tree
        camera = scene.camera_for(1.0)
        if setting.camera is not None:
            camera = setting.camera(camera)
        return figures_of(count_states(self.trees, *camera.rays(*(setting.size or (size, size)))))


def sweep(runner: Runner, name: str, view: View) -> list[Trial]:
    """Try all settings for a scene.

    Parameters
    ----------
    runner : Runner
    name : str
        The scene's, of `scenes.SCENES`.
    view : View
    """
    size = min(_SWEEP_SIZE, runner.size(SIZE))
    cache = _TreeCache(runner, view)
    tried = []
    for setting in settings_of(name, view.scene, size, runner.quick):

        def measure(setting: Setting = setting) -> dict[str, float]:
            return cache.figures(setting, size)

        figures = runner.measure(f"{name}, {setting.name}, {size} x {size}", measure)
        tried.append(
            Trial(setting.group, setting.label, setting.time, dict(setting.options), figures)
        )
    return tried


def distance(figures: Mapping[str, float], theirs: Mapping[str, float]) -> float:
    """Largest deviation from the published figures, as a logarithm."""
    return max(
        abs(math.log(max(figures[key], 1e-9) / theirs[key])) for key in theirs if theirs[key]
    )


def nearest(tried: Iterable[Trial], name: str) -> Trial:
    """The setting with the smallest largest deviation from the published figures."""
    theirs = published_figures(name)
    return min(tried, key=lambda one: distance(one.figures, theirs))


def explain_difference(
    key: str, ours: float, theirs: Mapping[str, float], tried: Iterable[Trial]
) -> str:
    """Name a setting that brings all figures near the published ones, this one among them.

    Parameters
    ----------
    key : str
        Name of the figure.
    ours : float
    theirs : mapping of str to float
        All published figures.
    tried : iterable of Trial

    Returns
    -------
    str
        Empty if the figure is near already. Settings of up to three groups that bring all figures
        near at once; or that the difference is not explained, with the setting that comes nearest
        in this figure alone.
    """
    if is_near(ours, theirs[key]):
        return ""
    ordered = sorted(
        tried, key=lambda one: abs(math.log(max(one.figures[key], 1e-9) / theirs[key]))
    )
    joint: dict[str, Trial] = {}
    for one in ordered:
        if _near_count(one, theirs) == len(theirs):
            joint.setdefault(one.group, one)
    chosen = list(joint.values())[:_MOST_REASONS]
    if chosen:
        return "; ".join(f"{one.name} gives {one.figures[key]:.3g}" for one in chosen)
    best = ordered[0]
    count = f"{_near_count(best, theirs)} of {len(theirs)}"
    return (
        f"{NOT_EXPLAINED}: {best.name} gives {best.figures[key]:.3g}, but {count} figures are near"
    )


def _near_count(trial: Trial, theirs: Mapping[str, float]) -> int:
    return sum(is_near(trial.figures[key], theirs[key]) for key in theirs)
