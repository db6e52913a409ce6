"""The cost of each traversal kernel: counted in its compiled code, and measured."""
