"""Compilation: decorators, threads, the on-disk cache, vector types. The only importer of numba."""
