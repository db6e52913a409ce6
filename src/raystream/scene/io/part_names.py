"""Names of a file's parts: paths, and numbers for names that repeat."""

from __future__ import annotations

from collections.abc import Iterable

from raystream.scene.mesh import Mesh

#: A file with more parts becomes fewer meshes: each costs far more than a triangle.
MAX_PARTS = 10_000

#: Longer paths lose their beginning, so that deep trees cannot fill memory with names.
MAX_LENGTH = 160


def path_name(*names: str) -> str:
    """Join the names of a part and of what it belongs to: ``truck/axle/wheel``."""
    return "/".join(filter(None, names))[-MAX_LENGTH:]


def number_repeats(names: Iterable[str]) -> list[str]:
    """Number the names that repeat: ``wheel``, ``wheel_2``, ``wheel_3``.

    Parameters
    ----------
    names : iterable of str
        As in the file, in the order of its parts.

    Returns
    -------
    list of str
        Distinct. The first part of each name keeps it; numbers that give a name of the file are
        left out. Where there are several parts, those without a name are called ``part``.
    """
    written = list(names)
    if len(written) > 1:
        written = [name or "part" for name in written]
    taken, last = set(written), dict.fromkeys(written, 0)
    distinct = []
    for name in written:
        last[name] += 1
        numbered = name
        while last[name] > 1 and (numbered := f"{name}_{last[name]}") in taken:
            last[name] += 1
        taken.add(numbered)
        distinct.append(numbered)
    return distinct


def number_meshes(meshes: Iterable[Mesh]) -> None:
    """Rename new meshes, so that their names differ; see `number_repeats`."""
    found = list(meshes)
    for mesh, name in zip(found, number_repeats(mesh.name for mesh in found), strict=True):
        mesh.name = name
