"""The subcommands of ``python -m deep``, a module each.

``train-offline`` is the dataclass ``TrainOffline`` in ``train_offline``: its fields are the
options, ``run()`` does the work. A module is imported when its command is asked for, so that
the list of commands costs neither torch nor tyro.
"""

COMMANDS = {
    "collect": "collect offline data from a task",
    "pretrain": "learn safety critics and recovery policies from offline data (Algorithm 1)",
    "offline-data": "put a run's replay buffer and random actions together, before violations",
    "train": "train task policies, behind a correction if --safety is given (Algorithm 2)",
    "train-offline": "train task policies from recorded transitions alone (IQL)",
    "choose-threshold": "choose epsilon, or WCSAC's cost limit: methods comparably safe",
    "evaluate": "evaluate trained policies on whole episodes, behind any filter",
    "compare": "score every method against the exact answer of a task",
    "sweep": "show what gamma_safe, epsilon, the expectile and the data mix do",
    "demo": "from nothing to the picture of learned and exact boundaries, in minutes",
    "grid": "run a study: tasks x methods x seeds, what is finished skipped",
    "report": "make tables and pictures from a study's saved runs, whatever has finished",
}
"""Each with one line for ``--help``."""
