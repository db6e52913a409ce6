"""Applications of ordered hits: thickness, attenuation, LiDAR returns, terrain."""
