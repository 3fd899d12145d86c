"""Models from and to files and other libraries.

:func:`load_model` and :func:`save_model` choose the format by the name; each format has its
own module.
"""

from dead_ends.io.errors import NoFailureWarning
from dead_ends.io.formats import load_model, save_model

__all__ = ["NoFailureWarning", "load_model", "save_model"]
