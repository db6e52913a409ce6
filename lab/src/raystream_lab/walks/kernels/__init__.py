"""Kernels that record, deduplicate and replay walks."""
