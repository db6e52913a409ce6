"""Builders that run on the GPU; the host launches their kernels and reads back only sizes.

A structure's options name its builder as their form ``"cuda build"``.
"""
