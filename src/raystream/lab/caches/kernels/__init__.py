"""Kernels that take a trace through a cache, one reference after the other."""
