"""The subcommands of ``python -m dead_ends``, a module each.

A module's name is the command's name. It has ``SUMMARY`` (one line),
``add_arguments(parser)`` and ``run(arguments)``, which returns the exit status. What is
slow to import is imported in ``run``. The other modules are what commands share or solve.
"""

COMMANDS = ("label", "explain", "certify", "check", "export", "convert", "statements", "page")
