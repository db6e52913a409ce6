"""Queries inside JAX's ``jit``, ``vmap`` and ``grad``, by callbacks."""

from raystream.jax.tracer import JaxHits, JaxTracer

__all__ = ["JaxHits", "JaxTracer"]
