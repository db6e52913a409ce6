"""Compiled parts of recorded walks."""
