"""Packets of 256 rays: loading them, their leaves and queries, and what they find."""
