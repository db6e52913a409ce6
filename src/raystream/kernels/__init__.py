"""Kernels that all structures share: ray preparation, slab and triangle tests, query loops."""
