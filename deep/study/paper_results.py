"""The paper's own numbers, to print beside ours.

Source: *Safe Reinforcement Learning with Dead-Ends Avoidance and Recovery*, Table tab_main
(task policies after training, with the violations during training) and Table tab_decoupled
(trained task policies behind a pretrained filter). Every figure there is an average over 500
random test episodes; the paper gives neither the number of seeds nor the spread over them, and
no budget of environment steps. Its tasks are those of the MuJoCo-based Safety Gym.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["PAPER_TASKS", "PaperScore", "paper_place", "paper_score"]

PAPER_TASKS = ("static-env", "dynamic-env", "point-goal1", "car-goal1", "doggo-goal1")
"""The tasks of the paper in its order, by the names that they have here."""


@dataclass(frozen=True)
class PaperScore:
    """One cell of a table of the paper.

    Attributes:
        acr: average cumulative reward of an episode.
        avr: share of the episodes that end in a violation.
        tv: violations during training; None where the table has none.
        arr: share of the steps that were corrected; None where the table has none.
    """

    acr: float
    avr: float
    tv: int | None = None
    arr: float | None = None


_MAIN = {
    "sac": (
        (2.754, 0.043, 1642),
        (17.434, 0.519, 3330),
        (12.609, 0.753, 12375),
        (16.727, 0.73, 14850),
        (16.956, 0.908, 31450),
    ),
    "wcsac": (
        (2.936, 0.008, 1453),
        (19.004, 0.069, 1451),
        (7.811, 0.055, 5739),
        (18.672, 0.035, 6199),
        (1.055, 0.013, 10825),
    ),
    "rrl": (
        (2.779, 0.038, 311),
        (7.479, 0.0, 92),
        (1.155, 0.078, 408),
        (1.827, 0.043, 1006),
        (6.969, 0.22, 546),
    ),
    "dea-rrl": (
        (2.882, 0.023, 119),
        (20.784, 0.018, 86),
        (14.079, 0.035, 236),
        (15.430, 0.091, 786),
        (7.002, 0.048, 706),
    ),
    # Trained offline: "the number of violations during training is 0", says the caption.
    "iql": (
        (2.630, 0.095, 0),
        (18.044, 0.565, 0),
        (12.740, 0.76, 0),
        (11.357, 0.94, 0),
        (18.889, 0.838, 0),
    ),
}
"""Table tab_main: (ACR, AVR, TV) of each method, one a task."""

_DECOUPLED = {
    "sac+rrl": (
        (2.379, 0.0, 0.417),
        (1.928, 0.004, 0.671),
        (5.462, 0.116, 0.546),
        (0.093, 0.034, 0.614),
        (0.751, 0.0, 0.987),
    ),
    "iql+rrl": (
        (1.308, 0.005, 0.426),
        (1.488, 0.008, 0.764),
        (3.669, 0.064, 0.581),
        (0.144, 0.094, 0.602),
        (0.656, 0.0, 0.941),
    ),
    "sac+dea-rrl": (
        (2.673, 0.0, 0.009),
        (18.769, 0.032, 0.242),
        (10.596, 0.0, 0.275),
        (8.165, 0.028, 0.334),
        (13.285, 0.002, 0.780),
    ),
    "iql+dea-rrl": (
        (2.947, 0.0, 0.031),
        (19.425, 0.078, 0.235),
        (9.926, 0.04, 0.322),
        (10.783, 0.116, 0.297),
        (9.407, 0.0, 0.846),
    ),
}
"""Table tab_decoupled: (ACR, AVR, ARR) of each task policy and filter, one a task."""


def paper_place(task: str) -> int:
    """A task's place in the paper's order; behind all of them if it is not the paper's."""
    name = task.removeprefix("real:")
    return PAPER_TASKS.index(name) if name in PAPER_TASKS else len(PAPER_TASKS)


def paper_score(task: str, method: str) -> PaperScore | None:
    """The paper's figures for a task and a method (``sac``, ``sac+dea-rrl``), if it has them.

    ``real:`` before a task means the MuJoCo-based one; it is the same task to the paper.
    """
    number = paper_place(task)
    if number == len(PAPER_TASKS):
        return None
    if method in _MAIN:
        acr, avr, tv = _MAIN[method][number]
        return PaperScore(acr, avr, tv=tv)
    if method in _DECOUPLED:
        acr, avr, arr = _DECOUPLED[method][number]
        return PaperScore(acr, avr, arr=arr)
    return None
