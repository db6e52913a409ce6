"""Kernels of the multipass machine besides the passes: scheduling, setup, compaction."""
