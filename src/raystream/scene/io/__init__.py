"""Readers of model files: one module a format, all of them bounded and total."""
