"""How Bellman's equations are solved: in Fractions, or in floats between verified bounds.

exact      policy iteration in Fractions
enclosure  bounds from below and above that close in on the fixed point
linear     guesses for the enclosure, from linear equations
operators  the operators whose fixed point is sought
rounding   sums whose rounding errors are bounded
"""
