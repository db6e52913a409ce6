"""Purcell 2002's experiments: ray casting as a stream computation."""
