"""Christen 2005: scenes A, B and C on a uniform grid, without recursion."""
