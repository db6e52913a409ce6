"""Foley and Sugerman's experiments: stackless kd-trees."""
