"""Kernels: what each step of a traversal costs, counted in its compiled code and measured."""
