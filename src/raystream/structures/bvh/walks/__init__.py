"""Walks of the tree: for a ray or a point, a packet, groups of rays, and rays in flight."""
