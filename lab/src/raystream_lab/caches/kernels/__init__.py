"""Kernels that simulate caches, one reference after another."""
