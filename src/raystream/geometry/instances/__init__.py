"""Instances: a tree over objects that are placed many times, each with a structure of its own."""
