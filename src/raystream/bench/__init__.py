"""Benchmarks: raystream and other ray tracers on the same rays, interleaved in time."""
