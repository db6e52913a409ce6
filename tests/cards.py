"""Cards: squares of which the half where x is negative is cut out, as files have them."""

from __future__ import annotations

import numpy as np

import raystream as rs

#: Ways to cut out half of a card: where alpha is below a half; without a cut-off; by the alpha of
#: a texture of colours; at another cut-off, which alpha from 0.2 to 1 passes in the middle; and by
#: the alpha of vertices.
KINDS = ("mask", "blend", "colours", "other cut-off", "vertices")

UP, DOWN = [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]


def cut_out(kind: str = "mask") -> rs.Material:
    """A material of which the left half is not there."""
    if kind == "vertices":
        return rs.Material("leaf", alpha_cutoff=0.5)
    alpha = np.array([[[0], [255]]], np.uint8)
    if kind == "other cut-off":
        alpha[0, 0] = 51
    texture = rs.Texture(alpha, wrap="clamp")
    if kind == "colours":
        colors = np.concatenate([np.full((1, 2, 3), 90, np.uint8), alpha], axis=2)
        texture = rs.Texture(colors, wrap="clamp").alpha()
    cutoffs = {"mask": 0.5, "blend": None, "colours": 0.5, "other cut-off": 0.6}
    return rs.Material("leaf", textures={"opacity": texture}, alpha_cutoff=cutoffs[kind])


def card(z: float = 0.0, material: int = 0, size: float = 1.0, low: float = -1.0) -> rs.Mesh:
    """A square that faces +z; with ``low=0.0``, only the half that no texture cuts out."""
    corners = np.array([[low, -1.0], [1.0, -1.0], [1.0, 1.0], [low, 1.0]])
    vertices = np.column_stack([size * corners, np.full(4, z)])
    faces, ids = [[0, 1, 2], [0, 2, 3]], np.full(2, material)
    return rs.Mesh(vertices, faces, texcoords=(corners + 1.0) / 2.0, material_ids=ids)


def faded(mesh: rs.Mesh, kind: str) -> rs.Mesh:
    """A mesh as its kind needs it: with an alpha of vertices, from 0 to 1 along x, or without."""
    if kind != "vertices":
        return mesh
    colors = np.ones((len(mesh.vertices), 4))
    colors[:, 3] = (mesh.vertices[:, 0] + 1.0) / 2.0
    attributes = {"texcoords": mesh.texcoords, "material_ids": mesh.material_ids}
    return rs.Mesh(mesh.vertices, mesh.faces, colors=colors, **attributes)


def over_ground(kind: str = "mask", placed: bool = False, low: float = -1.0) -> rs.Scene:
    """A card at z = 0, half of which is cut out, over opaque ground at z = -1."""
    materials = [cut_out(kind), rs.Material("ground")]
    meshes = [faded(card(low=low), kind), card(-1.0, 1, 9.0)]
    if not placed:
        return rs.Scene(meshes, materials=materials)
    raised = np.eye(3, 4)
    raised[2, 3] = 1.0  # objects lie one lower
    lower = [mesh.moved(mesh.vertices - [0.0, 0.0, 1.0]) for mesh in meshes]
    return rs.Scene.instances(lower, [raised, raised], [0, 1], materials=materials)
