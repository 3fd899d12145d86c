"""Learned safety critics, recovery policies and behavior correction for continuous tasks.

The method of the paper (DEA-RRL and its three relatives) where states are continuous and
only logged data are at hand, on small tasks with an exact answer to score it against.
"""
