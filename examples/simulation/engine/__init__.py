"""A four-cylinder engine whose parts are closed solids inside each other."""

from engine.model import DEFAULT_TRIANGLES, make_engine

__all__ = ["DEFAULT_TRIANGLES", "make_engine"]
