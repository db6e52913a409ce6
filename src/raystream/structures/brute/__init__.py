"""Brute force: every ray against every triangle. The reference for all other structures."""

from raystream.structures.brute.options import Brute

__all__ = ["Brute"]
