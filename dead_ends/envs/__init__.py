"""Builders of models: parameters in, :class:`dead_ends.SafeMDP` out."""
