"""The view of a scene without a camera: what to frame, from where, and whether from inside."""
