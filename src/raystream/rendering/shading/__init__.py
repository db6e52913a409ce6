"""Shading in compiled kernels: scenes as tables, points on surfaces, reflection, lights."""
