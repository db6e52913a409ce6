"""Kernels of the experiments on graphs."""
