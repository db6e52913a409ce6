"""Contender: what every ray tracer in a benchmark is asked to do."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "MISS_FROM",
    "AbsentError",
    "AllHits",
    "Answer",
    "Contender",
    "FirstHits",
    "Geometry",
    "Query",
    "Rays",
    "practice_geometry",
]

Query = Literal["first", "any", "multi"]

#: Packages say "no hit" with infinity, float32's largest number or 1e37; no scene is so large.
MISS_FROM = 1e30


class AbsentError(Exception):
    """A contender is not there: says why, and what to do."""


class Geometry(NamedTuple):
    """A scene's triangles, as a user has them.

    Parameters
    ----------
    vertices : ndarray of shape (V, 3), float32
    faces : ndarray of shape (F, 3), int32
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]


def practice_geometry() -> Geometry:
    """Make triangles for a first build, which loads and compiles what large scenes need too."""
    count = 20_000
    generator = np.random.default_rng(0)
    corners = generator.random((count, 1, 3)) + 0.01 * generator.normal(size=(count, 3, 3))
    faces = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    return Geometry(corners.reshape(-1, 3).astype(np.float32), faces)


class Rays(NamedTuple):
    """Rays, as a user has them: plain C-contiguous NumPy arrays.

    Parameters
    ----------
    origins, directions : ndarray of shape S + (3,), float32
        World space; directions need not be unit length.
    t_max : float
        Where all of them end, in direction lengths.
    """

    origins: NDArray[np.float32]
    directions: NDArray[np.float32]
    t_max: float

    def __len__(self) -> int:
        """Number of rays."""
        return self.origins.size // 3

    def rows(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Origins and directions of shape (N, 3), not copied."""
        return self.origins.reshape(-1, 3), self.directions.reshape(-1, 3)


class FirstHits(NamedTuple):
    """The nearest hit of each ray.

    Parameters
    ----------
    t : ndarray of N floats
        `MISS_FROM` or more is a miss.
    prim_id : ndarray of N ints
        Of no meaning for a miss.
    """

    t: NDArray[Any]
    prim_id: NDArray[Any]


class AllHits(NamedTuple):
    """All hits, by increasing t within each ray; as `MultiHits`."""

    ray_splits: NDArray[Any]
    t: NDArray[Any]
    prim_id: NDArray[Any]


Answer = FirstHits | AllHits | NDArray[np.bool_]


class Contender(ABC):
    """A ray tracer with one built structure.

    Every call starts from the user's arrays and ends with NumPy arrays: what a package needs
    in between, such as tensors of its own, is made within the call, and so within the time.

    Parameters
    ----------
    threads : int
        How many threads to use, where the package can be told.
    options : mapping
        The package's own.

    Attributes
    ----------
    modes : tuple of str
        Ways to ask that are all tried; the fastest counts.
    queries : frozenset of str
        What it can answer.
    notes : str
        What a reader of its figures should know.
    """

    modes: ClassVar[tuple[str, ...]] = ("",)
    queries: ClassVar[frozenset[Query]] = frozenset(("first", "any", "multi"))
    notes: ClassVar[str] = ""

    @abstractmethod
    def __init__(self, threads: int, options: Mapping[str, Any]) -> None:
        """Import the package."""

    @property
    @abstractmethod
    def version(self) -> str:
        """The package's version."""

    @abstractmethod
    def build(self, geometry: Geometry) -> None:
        """Make ready for queries, in place of what was built before."""

    @abstractmethod
    def release(self) -> None:
        """Forget what was built."""

    @abstractmethod
    def first_hit(self, rays: Rays, mode: str) -> FirstHits:
        """Find the nearest hit of each ray."""

    @abstractmethod
    def any_hit(self, rays: Rays, mode: str) -> NDArray[np.bool_]:
        """Find whether anything is in each ray's way."""

    def multi_hit(self, rays: Rays, mode: str) -> AllHits:
        """Find all hits of each ray, sorted."""
        raise NotImplementedError

    def ask(self, query: Query, rays: Rays, mode: str) -> Answer:
        """Ask one of the queries.

        Parameters
        ----------
        query : {"first", "any", "multi"}
        rays : Rays
        mode : str
            One of `modes`.
        """
        if query == "first":
            return self.first_hit(rays, mode)
        if query == "any":
            return self.any_hit(rays, mode)
        return self.multi_hit(rays, mode)
