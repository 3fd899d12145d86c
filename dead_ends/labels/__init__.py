"""Definition 2: S_fail, S_dead, S_safe, and how long the dead survive.

labelling       the result: labels, survival times T, horizons H and H_b
classification  from a model to its labelling
retrograde      deterministic models: backwards from failure, in linear time
qualitative     stochastic models: which states fail with probability 0, 1, or neither
implicit        models too large for a table
"""
