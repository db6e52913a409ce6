"""Lines of sight: which points, patches and faces see each other.

Results may be written to files and resumed, as those of `raystream.ray_files`.
"""
