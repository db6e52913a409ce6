"""Stages of renderers on a device: as in `rendering.integrator`, over streams that stay there.

The host learns after each surface how many paths go on, and how many rays to lights there are, two
numbers; and in the end the radiance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from raystream.cuda.rendering.band import DeviceBand, DeviceStream
from raystream.cuda.rendering.kernels import ADD, ASK_LIGHTS, FOLLOW, LIGHT, LOOK_AROUND, VIEW
from raystream.cuda.rendering.tables import plain
from raystream.jit.cuda import RangeKernel
from raystream.rendering.ao import distance_of, sampler_of, spawn_ambient_rays
from raystream.rendering.integrator import PathStage, find_surfaces, trace_shadow_rays
from raystream.rendering.path import shade_surfaces
from raystream.rendering.raycast import shade_by_lights
from raystream.rendering.vis import shade_by_facing_ratio
from raystream.rendering.whitted import lights_per_pixel, sample_all_lights

__all__ = ["STAGES"]

DeviceStage = Callable[[DeviceStream, DeviceBand], DeviceStream]


def _find_surfaces(stream: DeviceStream, band: DeviceBand) -> DeviceStream:
    """Trace the paths' rays."""
    to = band.hits.addresses._asdict()
    band.ask(band.scene.kernels.first_hit, stream.paths, stream.count, False, **to)
    return replace(stream, hits=band.hits)


def _meet_surfaces(stream: DeviceStream, band: DeviceBand) -> DeviceStream:
    """Add light that surfaces emit, ask for that of lights, and scatter the paths."""
    scene, rules = band.scene, plain(band.scene.setting.options["rules"])
    onward, (asked, rays) = band.onward, band.room_for_rays(1)
    band.run(
        FOLLOW,
        stream.count,
        np.int64(stream.count),
        *_met(stream),
        scene.table("tables"),
        scene.table("lights"),
        scene.sampler,
        band.sample,
        np.int64(stream.bounce),
        rules,
        band.first_pixel,
        band.radiance,
        onward.addresses,
        onward.counts,
        asked.addresses,
        asked.counts,
    )
    if stream.bounce >= rules.max_bounces:  # nothing goes on
        return DeviceStream(stream.paths, 0)
    path_count = onward.gather(stream.count, stream.paths)
    ray_count = asked.gather(stream.count, rays)
    band.wait()
    return DeviceStream(
        stream.paths,
        path_count(),
        stream.bounce + 1,
        asked=(asked, rays),
        asked_count=stream.count,
        ray_count=ray_count(),
    )


def _met(stream: DeviceStream) -> tuple[Any, Any]:
    """Addresses of paths, and of what they meet."""
    assert stream.hits is not None
    return stream.paths.addresses, stream.hits.addresses


def _shading(kernel: RangeKernel) -> DeviceStage:
    """A stage that shades first surfaces, whose paths then end."""

    def shade(stream: DeviceStream, band: DeviceBand) -> DeviceStream:
        tables = band.scene.table("tables"), band.scene.table("punctual")
        band.run(kernel, stream.count, *_met(stream), *tables, band.first_pixel, band.radiance)
        return DeviceStream(stream.paths, 0)

    return shade


def _ask_every_light(stream: DeviceStream, band: DeviceBand) -> DeviceStream:
    """Light first surfaces, by rays that are to be tested; the paths end."""
    each = lights_per_pixel(band.scene.setting)
    asked, rays = band.room_for_rays(each)
    tables = band.scene.table("tables"), band.scene.table("punctual")
    shared = *_met(stream), *tables, band.first_pixel, band.radiance
    own = np.uint64(each), asked.addresses, asked.counts
    band.run(ASK_LIGHTS, stream.count, *shared, *own)
    ray_count = asked.gather(stream.count, rays)
    band.wait()
    return DeviceStream(
        stream.paths, 0, asked=(asked, rays), asked_count=stream.count, ray_count=ray_count()
    )


def _ask_around(stream: DeviceStream, band: DeviceBand) -> DeviceStream:
    """Send rays from first surfaces; the paths end."""
    setting = band.scene.setting
    each = int(setting.options["rays"])
    asked, rays = band.room_for_rays(each)
    band.run(
        LOOK_AROUND,
        stream.count,
        *_met(stream),
        band.scene.table("tables"),
        plain(sampler_of(setting)),
        band.sample,
        np.int64(each),
        distance_of(setting),
        band.first_pixel,
        band.radiance,
        asked.addresses,
        asked.counts,
    )
    ray_count = asked.gather(stream.count, rays)
    band.wait()
    return DeviceStream(
        stream.paths, 0, asked=(asked, rays), asked_count=stream.count, ray_count=ray_count()
    )


def _reach_lights(stream: DeviceStream, band: DeviceBand) -> DeviceStream:
    """Add what the lights send where nothing is in the way."""
    if stream.asked is not None and stream.ray_count:
        slots, rays = stream.asked
        blocked = band.empty("answers", stream.ray_count, np.uint8)
        any_hit = band.scene.kernels.any_hit
        band.ask(any_hit, rays, stream.ray_count, True, seen=blocked.address)
        to = rays.addresses, blocked.address, band.first_pixel, band.radiance
        band.run(ADD, stream.asked_count, slots.counts, *to)
    return replace(stream, asked=None, asked_count=0, ray_count=0)


#: What is done on a device in place of a renderer's stage.
STAGES: MappingProxyType[PathStage, DeviceStage] = MappingProxyType(
    {
        find_surfaces: _find_surfaces,
        shade_surfaces: _meet_surfaces,
        shade_by_lights: _shading(LIGHT),
        shade_by_facing_ratio: _shading(VIEW),
        sample_all_lights: _ask_every_light,
        spawn_ambient_rays: _ask_around,
        trace_shadow_rays: _reach_lights,
    }
)
