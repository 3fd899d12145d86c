"""Learned filters scored against the exact answer."""
