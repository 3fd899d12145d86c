"""Labels with a proof that can be checked without trusting the solver.

certificate  certify, and the file of a certificate
search       the ranks that a certificate consists of
checker      the check; it shares no code with the solver
"""
