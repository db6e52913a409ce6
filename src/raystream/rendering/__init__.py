"""Renderers: lists of stages over streams of paths; sums of samples, colour encoding, images."""
