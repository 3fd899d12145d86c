"""Safety Gym's goal tasks: vectorised (``tasks``), and the simulator itself (``real``).

Compiled functions are kept in ``__pycache__``. Numba renews one only when its own file changes:
whoever edits a module here that others call removes that folder.
"""
