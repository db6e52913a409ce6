"""The Rayforce poster of 2013: four kinds of images, multi-hit, and what a ray pays for."""
