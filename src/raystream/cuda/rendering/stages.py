"""Stages of renderers on a device: those of `rendering.integrator`, over streams in its memory.

After each surface the host reads two numbers, of continuing paths and of shadow rays; at the end it
reads the radiance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from raystream.cuda.rendering import kernels
from raystream.cuda.rendering.columns import StreamColumns
from raystream.cuda.rendering.device_band import DeviceBand, DeviceStream, ShadowStream
from raystream.cuda.rendering.slots import Slots
from raystream.jit.cuda import RangeKernel
from raystream.rendering.ao import distance_of, sampler_of, spawn_ambient_rays
from raystream.rendering.integrator import PathStage, find_surfaces, trace_shadow_rays
from raystream.rendering.path import shade_surfaces
from raystream.rendering.raycast import shade_by_lights
from raystream.rendering.sampling.sampler import PixelSample
from raystream.rendering.shading.ambient_occlusion import OcclusionOptions
from raystream.rendering.vis import shade_by_facing_ratio
from raystream.rendering.whitted import lights_per_pixel, sample_all_lights

DeviceStage = Callable[[DeviceStream, DeviceBand], DeviceStream]


def _find_surfaces(stream: DeviceStream, band: DeviceBand) -> DeviceStream:
    """Trace the paths' rays."""
    first_hit = band.scene.queries.kernels.first_hit
    band.trace(first_hit, stream.paths, stream.count, False, band.hits)
    return replace(stream, hits=band.hits)


def _shade_surfaces(stream: DeviceStream, band: DeviceBand) -> DeviceStream:
    """Add emitted light, sample lights, and scatter the paths."""
    scene, options = band.scene, band.scene.context.options["rules"]
    onward, (slots, rays) = band.onward, band.shadow_rays(1)
    band.run(
        kernels.shade_paths,
        stream.count,
        band.batch(stream),
        scene.table("tables"),
        scene.table("lights"),
        PixelSample(scene.sampler, band.sample),
        stream.bounce,
        options,
        onward.addresses,
        slots.addresses,
    )
    if stream.bounce >= options.max_bounces:  # the paths end
        return DeviceStream(stream.paths, 0)
    path_count = onward.compact(stream.count, stream.paths)
    ray_count = slots.compact(stream.count, rays)
    band.wait()
    shadows = ShadowStream(slots, rays, stream.count, ray_count())
    return DeviceStream(stream.paths, path_count(), stream.bounce + 1, shadows=shadows)


def _local_stage(kernel: RangeKernel) -> DeviceStage:
    """A stage that shades first surfaces, whose paths then end."""

    def shade(stream: DeviceStream, band: DeviceBand) -> DeviceStream:
        tables = band.scene.table("tables"), band.scene.table("punctual")
        band.run(kernel, stream.count, band.batch(stream), *tables)
        return DeviceStream(stream.paths, 0)

    return shade


def _sample_all_lights(stream: DeviceStream, band: DeviceBand) -> DeviceStream:
    """Send shadow rays from first surfaces to all lights; the paths end."""
    slots, rays = band.shadow_rays(lights_per_pixel(band.scene.context))
    tables = band.scene.table("tables"), band.scene.table("punctual")
    band.run(kernels.sample_all_lights, stream.count, band.batch(stream), *tables, slots.addresses)
    return _only_shadow_rays(stream, band, slots, rays)


def _spawn_ambient_rays(stream: DeviceStream, band: DeviceBand) -> DeviceStream:
    """Send ambient occlusion rays from first surfaces; the paths end."""
    context = band.scene.context
    ray_count = int(context.options["rays"])
    slots, rays = band.shadow_rays(ray_count)
    sample = PixelSample(sampler_of(context), band.sample)
    options = OcclusionOptions(ray_count, distance_of(context))
    shared = band.batch(stream), band.scene.table("tables"), sample, options
    band.run(kernels.spawn_ao_rays, stream.count, *shared, slots.addresses)
    return _only_shadow_rays(stream, band, slots, rays)


def _only_shadow_rays(
    stream: DeviceStream, band: DeviceBand, slots: Slots, rays: StreamColumns
) -> DeviceStream:
    """Compact shadow rays, of paths that end."""
    ray_count = slots.compact(stream.count, rays)
    band.wait()
    shadows = ShadowStream(slots, rays, stream.count, ray_count())
    return DeviceStream(stream.paths, 0, shadows=shadows)


def _trace_shadow_rays(stream: DeviceStream, band: DeviceBand) -> DeviceStream:
    """Add the light of unblocked shadow rays."""
    shadows = stream.shadows
    if shadows is not None and shadows.ray_count:
        rays, counts = shadows.rays, shadows.slots.addresses.counts
        blocked = band.empty("answers", shadows.ray_count, np.uint8)
        any_hit = band.scene.queries.kernels.any_hit
        band.trace(any_hit, rays, shadows.ray_count, True, blocked.address)
        to = rays.addresses, blocked.address, band.first_pixel, band.radiance
        band.run(kernels.add_unblocked, shadows.thread_count, counts, *to)
    return replace(stream, shadows=None)


#: Stages on a device, by the renderers' stages.
STAGES: MappingProxyType[PathStage, DeviceStage] = MappingProxyType(
    {
        find_surfaces: _find_surfaces,
        shade_surfaces: _shade_surfaces,
        shade_by_lights: _local_stage(kernels.shade_unshadowed),
        shade_by_facing_ratio: _local_stage(kernels.shade_facing_ratio),
        sample_all_lights: _sample_all_lights,
        spawn_ambient_rays: _spawn_ambient_rays,
        trace_shadow_rays: _trace_shadow_rays,
    }
)
