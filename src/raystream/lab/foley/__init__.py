"""Foley and Sugerman's experiments: kd-trees without a stack."""
