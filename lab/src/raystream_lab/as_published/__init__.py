"""Kernels as the papers print or describe them, beside the engine's, for counts and comparison.

They run on the multipass machine's streams, but promise nothing of the engine: a ray through an
edge may miss both triangles, and one in a plane of the structure may be lost.
"""
