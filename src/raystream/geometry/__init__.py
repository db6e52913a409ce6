"""Kinds of geometry besides triangles, and float64: one folder each, from records to kernels."""
