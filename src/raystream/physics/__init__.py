"""Ordered hits put to use: thickness, attenuation, LiDAR returns."""
