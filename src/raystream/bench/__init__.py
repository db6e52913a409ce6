"""Bench: raystream beside other ray tracers, on the same rays in the same minutes."""
