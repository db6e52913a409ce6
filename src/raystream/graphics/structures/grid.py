"""The grid as shaders read it."""

from __future__ import annotations

import numpy as np

from raystream.graphics.structures.base import ShaderStructure, budget_for, numbers
from raystream.structures.grid.structure import GridStructure

_PAD = 0


def shader_structure(grid: GridStructure) -> ShaderStructure:
    """Lists of triangles of the coarse and fine cells."""
    lattice, fine = grid.lattice, grid.fine
    triangles = grid.triangles
    tree = numbers(
        *(*map(float, lattice.low), _PAD, *map(float, lattice.high), _PAD),
        *(*map(float, lattice.size), _PAD, *map(float, lattice.counts), len(fine.cells)),
        len(triangles.prim_ids),
    )
    return ShaderStructure(
        name="grid",
        shader="grid.wgsl",
        tree=tree,
        arrays=(
            grid.lists.splits,
            grid.lists.references,
            triangles.corners,
            fine.children(lattice.cell_count),
            fine.records().astype(np.uint32),
            fine.lists.splits,
            fine.lists.references,
        ),
        budget=budget_for(_most_steps(grid)),
    )


def _most_steps(grid: GridStructure) -> int:
    """Upper bound of a ray's cells and triangles: all along a coarse path, and all fine ones."""
    references = len(grid.lists.references) + len(grid.fine.lists.references)
    fine_cells = int(grid.fine.counts.astype(np.int64).sum())
    return sum(grid.lattice.counts) + fine_cells + references
