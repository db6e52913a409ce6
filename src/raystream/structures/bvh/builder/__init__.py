"""The builder: a binary tree, collapsed to eight children."""
