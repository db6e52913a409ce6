"""The registry of structures: the classes of their options, which locate their parts.

Cheap to import: structures are imported when they are built.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from raystream.core.options import Options
from raystream.core.scene_kinds import check_support

if TYPE_CHECKING:
    from raystream.core.store import Store
    from raystream.core.triangles import Triangles
    from raystream.jit.threads import Progress
    from raystream.structures.base import Structure


@dataclass(frozen=True, kw_only=True)
class StructureOptions(Options):
    """The options of an acceleration structure; `register_structure` registers the class.

    Attributes
    ----------
    name : str
        Its name in ``Tracer(structure=...)``.
    structure : type of Structure, or str
        The class of the built structure, or its ``"module:name"``, imported on demand.
    cell_counter : {"leaves", "steps"}
        The column of `raystream.machines.RayCounters` that counts the cells a ray visits.
    forms : mapping of str to callable or str
        Other ways to trace or build it, each an object or its ``"module:name"``:
        ``"nearest"``, its loop over points (of `kernels.point_queries.nearest_answer`), and
        ``"nearest search"``, the search that loops on other devices run (`PointSearch` there);
        ``"multipass"``, its steps (`raystream.machines.steps.base.Steps`); ``"graphics"`` and
        ``"graphics multipass"``, its shaders; ``"cuda build"``, its builder on the device; and
        ``"cuda kernels"``, a module of layouts with kernels for CUDA alone. Without
        ``"cuda kernels"``, CUDA runs the CPU's traversal.
    """

    structure: ClassVar[Any]
    cell_counter: ClassVar[str] = "leaves"
    forms: ClassVar[Mapping[str, Any]] = MappingProxyType({})


#: Options of structures by name, the default first.
STRUCTURES: dict[str, type[StructureOptions]] = {}


_Kind = TypeVar("_Kind", bound=StructureOptions)


def register_structure(options: type[_Kind]) -> type[_Kind]:
    """Register a structure under its name.

    Parameters
    ----------
    options : type of StructureOptions
        A frozen dataclass.

    Returns
    -------
    type of StructureOptions
        The same, so that this works as a decorator.

    Raises
    ------
    ValueError
        If another structure has that name.
    """
    if STRUCTURES.get(options.name, options) is not options:
        raise ValueError(f"structure: {options.name!r} is registered already")
    STRUCTURES[options.name] = options
    return options


def options_of(
    structure: str | StructureOptions, options: Mapping[str, Any] = MappingProxyType({})
) -> StructureOptions:
    """Make options from the name of a structure; an options object is returned as it is.

    Parameters
    ----------
    structure : str or StructureOptions
    options : mapping
        Options of the structure of that name.

    Raises
    ------
    ValueError
        If the name is unknown, or an option's value is out of range.
    TypeError
        If the structure has no such option, or if options are given beside an options object.
    """
    if isinstance(structure, StructureOptions):
        if options:
            kind, name = type(structure).__name__, next(iter(options))
            raise TypeError(f"{structure.name}: give {name!r} as an argument of {kind}")
        return structure
    if structure not in list(STRUCTURES):  # it may be unhashable
        known = ", ".join(map(repr, STRUCTURES))
        raise ValueError(f"structure: expected one of {known}, got {structure!r}")
    made = STRUCTURES[structure]
    for option in options:
        if option not in made.names():
            has = f"it has {', '.join(made.names())}" if made.names() else "it has none"
            raise TypeError(f"{structure}: has no option {option!r}; {has}")
    return made(**options)


def structure_class(name: str) -> type[Structure]:
    """The class of a built structure."""
    return _imported(STRUCTURES[name].structure)


#: Modules whose ``STRUCTURES`` are those of other kinds of scene than triangles in float32.
_OF_KINDS = {
    "float64": "raystream.geometry.float64.structure",
    "instances": "raystream.geometry.instances.structure",
    "fields": "raystream.geometry.primitives.structure",
    "shapes": "raystream.geometry.primitives.structure",
    "spheres": "raystream.geometry.primitives.structure",
}


def builder_for(name: str, store: Store) -> Any:
    """The class, or function, that builds a structure of a scene from its geometry and options.

    Raises
    ------
    ValueError
        If the structure does not support the kind of scene.
    """
    if not store.kinds:
        return structure_class(name)
    check_support(f"structure={name!r}", store, ValueError)
    return _imported(_OF_KINDS[store.kinds[0]]).STRUCTURES[name]


def form_of(name: str, form: str) -> Any:
    """Another way to trace or build a structure, or None.

    Parameters
    ----------
    name : str
        Of the structure, which need not be registered.
    form : str
        A key of `StructureOptions.forms`.
    """
    found = STRUCTURES[name].forms.get(form) if name in STRUCTURES else None
    return None if found is None else _imported(found)


def names_with(form: str) -> tuple[str, ...]:
    """The names of the structures that have a form."""
    return tuple(name for name, one in STRUCTURES.items() if form in one.forms)


def build_structure(
    structure: str | StructureOptions,
    triangles: Triangles,
    *,
    progress: Progress | None = None,
    **options: Any,
) -> Structure:
    """Build a structure on the CPU.

    Parameters
    ----------
    structure : str or StructureOptions
        A key of `STRUCTURES`, or an options object.
    triangles : Triangles
    progress : callable, optional
        Called with (triangles placed, triangles).
    **options
        Build options of the structure of that name.

    Raises
    ------
    ValueError, TypeError
        See `options_of`.
    """
    chosen = options_of(structure, options)
    return structure_class(chosen.name)(triangles, chosen, progress=progress)


def _imported(place: Any) -> Any:
    """The object named ``"module:name"``, or a module; anything else as it is."""
    return _named(place) if isinstance(place, str) else place


@cache  # to look it up takes two microseconds
def _named(place: str) -> Any:
    module, _, name = place.partition(":")
    found = importlib.import_module(module)
    return getattr(found, name) if name else found
