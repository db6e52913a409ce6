"""Rays, hits, bounds and triangles: dtypes, shapes and validation. Imports no other package."""
