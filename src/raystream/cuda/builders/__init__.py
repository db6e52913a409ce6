"""Structures built on the device: what takes part is kernels, and sizes that the host must know.

A structure's options name its builder, as their form ``"cuda build"``.
"""
