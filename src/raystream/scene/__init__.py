"""Scenes: meshes, materials, textures, lights and cameras, from files or generated."""
