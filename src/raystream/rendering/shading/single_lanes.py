"""Shading of one path at a time, where each thread or record is a lane: on CUDA and in streams.

Copies of the functions that shade 16 paths at a time, with vectors of one lane: the same bits.
"""

from __future__ import annotations

from raystream.jit.simd import single_lane
from raystream.rendering.shading.ambient_occlusion import spawn_path_ao_rays
from raystream.rendering.shading.camera_rays import camera_ray_block
from raystream.rendering.shading.local_shading import facing_ratio_block, unshadowed_block
from raystream.rendering.shading.paths import shade_path_block
from raystream.rendering.shading.rows import SINGLE_ROWS

camera_ray = single_lane(camera_ray_block)
ambient_rays = single_lane(spawn_path_ao_rays, SINGLE_ROWS)
shade_path = single_lane(shade_path_block, SINGLE_ROWS)
unshadowed = single_lane(unshadowed_block)
facing_ratio = single_lane(facing_ratio_block)
