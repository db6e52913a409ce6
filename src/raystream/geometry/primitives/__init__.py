"""Primitives beside triangles: spheres, and terrain as height fields without triangles."""
