"""Queries in float64 on CUDA: the CPU's searches of single rays, one ray per thread."""
