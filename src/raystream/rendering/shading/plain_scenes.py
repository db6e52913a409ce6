"""Shading kernels for plain scenes: without textures, roughness, and images of the sky.

A scene without them need not wait until their code is compiled: of 7.7 s for `shade_unshadowed`,
3.4. A plain copy of a kernel is the kernel with functions for them replaced by trivial ones. In
plain scenes these are never reached, so the bits are the same.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from raystream.jit.copies import Copies
from raystream.jit.cpu import device, kernel
from raystream.jit.warm import PLAIN
from raystream.rendering.shading.bsdf import metal_or_plastic
from raystream.rendering.shading.coatings import coat_at, sheen_at
from raystream.rendering.shading.material_values import looked_up
from raystream.rendering.shading.microfacet import eval_rough_reflection, visible_facet
from raystream.rendering.shading.sheen import eval_sheen
from raystream.rendering.shading.sky import image_radiance
from raystream.rendering.shading.sky_lanes import (
    image_radiance_lanes,
    relative_pdf_lanes,
    sample_image_lanes,
)
from raystream.rendering.shading.surface_points import with_normal_maps
from raystream.rendering.shading.tables import IS_ROUGH, IS_TEXTURED

_WHOLE = np.float32(1.0)


@device
def _white(tables, point, role, values):  # noqa: ARG001 - as of `looked_up`, and so on below
    white = point.nx * np.float32(0.0) + _WHOLE
    return white, white, white


@device
def _keep_point(tables, prim, weights, point, smooth, direction, is_hit):  # noqa: ARG001
    return point


@device
def _not_rough(tables, point, roughness, base, plastic, grazing):  # noqa: ARG001
    return roughness, roughness, plastic, grazing


@device
def _diffuse_color(diffuse, mirror, grazing, alpha, normal, back, toward):  # noqa: ARG001
    return diffuse, alpha


@device
def _keep_normal(alpha, normal, back, u, v):  # noqa: ARG001
    return normal


@device
def _no_coat(tables, point, back):  # noqa: ARG001
    return point.nx, point.nx


@device
def _no_sheen(tables, point, back):  # noqa: ARG001
    return back, point.nx, point.nx


@device
def _no_fibres(alpha, normal, back, toward):  # noqa: ARG001
    return alpha


@device
def _constant(sky, x, y, z):  # noqa: ARG001
    return sky.color


@device
def _no_radiance(sky, toward, mask):  # noqa: ARG001
    return toward


@device
def _no_density(sky, toward, mask):  # noqa: ARG001
    return toward[0]


@device
def _no_sample(sky, u, v, mask):  # noqa: ARG001
    return (u, u, u), v


_PLAIN = Copies(
    PLAIN.removeprefix("_"),
    {
        looked_up: _white,
        with_normal_maps: _keep_point,
        metal_or_plastic: _not_rough,
        eval_rough_reflection: _diffuse_color,
        visible_facet: _keep_normal,
        coat_at: _no_coat,
        sheen_at: _no_sheen,
        eval_sheen: _no_fibres,
        image_radiance: _constant,
        image_radiance_lanes: _no_radiance,
        relative_pdf_lanes: _no_density,
        sample_image_lanes: _no_sample,
    },
)


def plain_copy(shading: Any) -> Any:
    """Make the kernel for plain scenes from that for all."""
    return kernel(_PLAIN.python(shading))


def kernel_for(shading: Any, of_plain_scenes: Any, tables: Any, lights: Any) -> Any:
    """Choose between a kernel and its plain copy.

    Parameters
    ----------
    shading, of_plain_scenes : kernel
    tables : SceneTables
    lights : LightTables or PunctualLights
    """
    is_plain = not (tables.kinds & (IS_TEXTURED | IS_ROUGH) or lights.sky.image)
    return of_plain_scenes if is_plain else shading
