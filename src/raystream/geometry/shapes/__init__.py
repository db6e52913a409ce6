"""Shapes whose geometry users write: where rays and points meet them."""
