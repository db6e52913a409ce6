"""Purcell 2002: ray casting as a stream computation, re-run."""
