"""Spheres: where rays meet them."""
