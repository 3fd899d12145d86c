"""Transitions: collected or read, normalised, and drawn in minibatches."""
