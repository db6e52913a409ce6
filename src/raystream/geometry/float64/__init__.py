"""float64: tracers with ``precision="float64"``. Exact triangle tests, and searches with them.

Boxes are in float32, rounded outward. Rays, triangles and results are in float64; where float64
leaves a sign or a digit in doubt, exact arithmetic decides. What else changes stands in
``structure.py``: the batch of rays, the searches, the traversal and the kernels for many rays.
"""
