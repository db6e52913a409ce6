"""Brute force: every ray against every triangle. The oracle of all other structures."""

from raystream.structures.brute.structure import Brute

__all__ = ["Brute"]
