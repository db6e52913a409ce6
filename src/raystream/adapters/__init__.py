"""Interfaces of other libraries, answered by a `Tracer`: trimesh's and Open3D's ray queries."""
