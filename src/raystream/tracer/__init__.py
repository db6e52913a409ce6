"""Tracer: turns arguments into a query, hands it to a backend, and gives back hits."""

from raystream.tracer.tracer import Tracer

__all__ = ["Tracer"]
