"""Engine: a four-cylinder engine whose parts are closed solids inside each other."""

from __future__ import annotations

import raystream as rs
from engine.assembly import Detail, Piece, assemble, fitted
from engine.crank_drive import crankcase, crankshaft, oil_pan, pistons
from engine.mounts import FLOOR, accessories, manifolds, stand
from engine.valve_train import camshaft, cylinder_head, head_cover, spark_plugs, valves

__all__ = ["DEFAULT_TRIANGLES", "make_engine"]

DEFAULT_TRIANGLES = 60_000

#: Below this an engine would be unrecognisable.
MIN_TRIANGLES = 24

#: Count from which edges have bevels and vertices normals.
SMOOTH_TRIANGLES = 35_000

MATERIALS = (
    rs.Material(
        "cast iron", diffuse=(0.13, 0.16, 0.19), specular=(0.12, 0.12, 0.12), shininess=25.0
    ),
    rs.Material(
        "aluminium",
        diffuse=(0.42, 0.43, 0.45),
        specular=(0.3, 0.3, 0.3),
        shininess=40.0,
        reflection=(0.06, 0.06, 0.06),
    ),
    rs.Material(
        "steel",
        diffuse=(0.24, 0.24, 0.25),
        specular=(0.5, 0.5, 0.5),
        shininess=90.0,
        reflection=(0.15, 0.15, 0.16),
    ),
    rs.Material(
        "turned steel",
        diffuse=(0.3, 0.3, 0.31),
        specular=(0.55, 0.55, 0.55),
        shininess=120.0,
        reflection=(0.3, 0.3, 0.31),
    ),
    rs.Material(
        "black paint", diffuse=(0.03, 0.03, 0.033), specular=(0.2, 0.2, 0.2), shininess=60.0
    ),
    rs.Material(
        "red paint",
        diffuse=(0.55, 0.04, 0.03),
        specular=(0.25, 0.25, 0.25),
        shininess=90.0,
        reflection=(0.04, 0.04, 0.04),
    ),
    rs.Material("rubber", diffuse=(0.035, 0.035, 0.035)),
    rs.Material(
        "exhaust steel",
        diffuse=(0.3, 0.22, 0.15),
        specular=(0.4, 0.34, 0.28),
        shininess=50.0,
        reflection=(0.1, 0.085, 0.07),
    ),
    rs.Material("ceramic", diffuse=(0.85, 0.84, 0.8), specular=(0.3, 0.3, 0.3), shininess=120.0),
    rs.Material("oil", diffuse=(0.5, 0.32, 0.05)),
    rs.Material("wood", diffuse=(0.5, 0.34, 0.18)),
    rs.Material("table", diffuse=(0.4, 0.4, 0.385)),
)


def make_engine(triangles: int = DEFAULT_TRIANGLES) -> rs.Scene:
    """Make a four-cylinder engine, for X-ray images and shotlines.

    Each mesh is a solid, such as ``"piston 1"``: closed, its front sides outward, and those of
    its cavities inward. Where a cavity would be open, 0.2 mm of wall remain, and a part that
    passes there overlaps it; less than 0.3 % of a line's way through solids lies in two of them.
    The firing order is 1-3-4-2; the cams open the valves.

    Parameters
    ----------
    triangles : int
        Target count, which is not exceeded; the actual count is less by at most 11 below 10,000,
        by at most 1 % above. More triangles give rounder parts and more teeth. Below 16,500 some
        parts are missing, first the small ones; below 35,000 all faces are flat.

    Returns
    -------
    rs.Scene
        In metres, y up, on a table, with a sun and a sky. The crankshaft is parallel to the x
        axis.

    Raises
    ------
    ValueError
        If the target is below `MIN_TRIANGLES`.
    """
    if triangles < MIN_TRIANGLES:
        raise ValueError(f"triangles: expected at least {MIN_TRIANGLES}, got {triangles:,}")
    pieces = fitted(all_pieces, triangles, SMOOTH_TRIANGLES)
    return rs.Scene(
        assemble(pieces, (0.0, -FLOOR, 0.0)),
        materials=MATERIALS,
        lights=(
            rs.DirectionalLight((0.55, -1.0, -0.75), (2.5, 2.35, 2.1)),
            rs.EnvironmentLight((0.28, 0.31, 0.36)),
        ),
        background=(0.4, 0.47, 0.56),
        camera=rs.Camera((-0.72, 0.72, 1.0), (-0.005, 0.265, 0.0), fov=34.0),
        name="engine",
    )


def all_pieces(detail: Detail) -> list[Piece]:
    """Return all pieces, the most important first."""
    block, *rest_of_block = crankcase(detail)
    pan, *rest_of_pan = oil_pan(detail)
    head, *rest_of_head = cylinder_head(detail)
    cover, *rest_of_cover = head_cover(detail)
    table, *blocks = stand(detail)
    return [
        *(block, pan, table, cover, head, *blocks),
        *rest_of_block,
        *pistons(detail),
        *rest_of_pan,
        *crankshaft(detail),
        *rest_of_cover,
        *camshaft(detail),
        *manifolds(detail),
        *accessories(detail),
        *rest_of_head,
        *valves(detail),
        *spark_plugs(detail),
    ]
