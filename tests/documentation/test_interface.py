"""The API page has every public name."""

from __future__ import annotations

import importlib
import re

import pytest

import raystream
from documentation.commands import REPOSITORY
from extras import need

PAGE = (REPOSITORY / "docs" / "api.rst").read_text(encoding="utf-8")

#: Modules whose names are for users, beside the package's own.
MODULES = (
    "adapters.open3d",
    "adapters.trimesh",
    "cluster",
    "graphics",
    "graphics.streams",
    "jax",
    "line_of_sight.surface_points",
    "line_of_sight.view_factors",
    "line_of_sight.visibility",
    "line_of_sight.visible_faces",
    "machines",
    "physics.attenuation",
    "physics.lidar",
    "physics.sweep_patterns",
    "physics.sweeps",
    "physics.terrain",
    "programs",
    "rendering.render",
    "rendering.compare",
    "rendering.frames",
    "rendering.heatmap",
    "scene.animation",
    "scene.sensor_track",
    "scene.textures",
    "stepper",
    "streams",
    "torch",
    "web",
)

#: Those of the lab.
LAB_MODULES = ("caches", "cost_model", "walks")

#: Names of those modules that the package's own rooms share.
FOR_ROOMS = {
    "machines": {"Branching", "Observer", "make_machine", "own_options"},
    "rendering.compare": {"compare", "draw_difference"},  # methods of Image
    "rendering.heatmap": {"title_of"},
    "rendering.frames": {"sample_count_of", "split_options", "timeline_of"},
}

#: All top-level names; other names are imported from their modules.
NAMES = """
    Animation Camera CameraTrack ClosestPoints Decision DirectionalLight EnvironmentLight
    FileFormatError Hits Image MODES Material Mesh MultiHits PointLight RayHit RayStatus
    RaystreamError RaystreamWarning Scene SpotLight Texture Tracer __version__ attenuation cluster
    daylight export_page heatmap lidar_returns load query_zarr render render_frames
    set_thread_count streams textures thickness thread_count view write_video Brute Bvh Graph Grid
    KdTree StructureOptions
    register_structure Cpu Cuda Graphics Branching Compute Multipass
    surface_points view_factors visibility visible_faces
    SensorTrack Shape lidar_sweep sweep_patterns terrain
"""


def documented() -> set[str]:
    """Give the last parts of the names on the page."""
    found = re.findall(r"^\.\. (?:auto\w+|data):: (\S+)((?:\n {10,}\S+)*)", PAGE, re.MULTILINE)
    names = [name for first, more in found for name in (first, *more.split())]
    return {name.rpartition(".")[2] for name in names}


def test_the_package_has_these_names_and_no_others():
    assert sorted(raystream.__all__) == sorted(NAMES.split())
    assert dir(raystream) == sorted(raystream.__all__)
    for name in set(raystream.__all__) - {"cluster"}:  # an extra
        assert getattr(raystream, name) is not None


@pytest.mark.parametrize("name", sorted(set(raystream.__all__) - {"__version__"}))
def test_the_package_s_names_are_there(name):
    # A module is there if its names are.
    module = name in {"cluster", "streams", "sweep_patterns", "textures"}
    assert name in documented() or (module and f"raystream.{name}." in PAGE)


@pytest.mark.parametrize(
    "module",
    [f"raystream.{name}" for name in MODULES] + [f"raystream_lab.{name}" for name in LAB_MODULES],
)
def test_the_modules_names_are_there(module):
    try:
        names = importlib.import_module(module).__all__
    except ModuleNotFoundError as error:  # an extra
        need((error.name or "").partition(".")[0])
        raise
    wanted = {name for name in names if not name.isupper()} - FOR_ROOMS.get(
        module.partition(".")[2], set()
    )
    assert not wanted - documented(), f"docs/api.rst lacks {sorted(wanted - documented())}"


def test_nothing_is_there_twice():
    names = re.findall(r"^\.\. auto\w+:: (\S+)", PAGE, re.MULTILINE)
    last = [name.rpartition(".")[2] for name in names]
    twice = {name for name in names if names.count(name) > 1}
    assert not twice
    assert len(last) > 90
