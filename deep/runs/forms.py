"""The forms of Algorithm 1 as the study names, runs and draws them; needs no torch to be read."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["FORM_ROWS", "FormRow", "LineStyle"]

LineStyle = str | tuple[int, tuple[float, ...]]
"""Of a line in a figure, in matplotlib's words."""


@dataclass(frozen=True)
class FormRow:
    """A form's row.

    Attributes:
        title: its name in print.
        color, line: of its curves.
        study: the options of its pretraining.
        plugged: whether task policies are put behind it that it has never met.
        proposed: whether it is a proposal: ablations name it after what it is compared with.
        from_horizon: whether gamma_safe follows from H.
    """

    title: str
    color: str
    line: LineStyle = "-"
    study: tuple[str, ...] = ("--polyak", "0.1")
    plugged: bool = False
    proposed: bool = False
    from_horizon: bool = False


FORM_ROWS: dict[str, FormRow] = {
    "rrl": FormRow(
        title="RRL",
        color="#D55E00",
        line=(0, (4, 1.5)),
        plugged=True,
    ),
    "rrl-msdp": FormRow(
        title="RRL (MSDP)",
        color="#CC79A7",
        line=(0, (4, 1.2, 1, 1.2)),
    ),
    "dea-rrl": FormRow(
        title="DEA-RRL",
        color="#0072B2",
        plugged=True,
        proposed=True,
    ),
    "dea-rrl-annealed": FormRow(
        title="DEA-RRL (annealed)",
        color="#009E73",
        study=("--final-expectile", "0.1"),  # one that noise allows
        plugged=True,
        proposed=True,
        from_horizon=True,
    ),
    "dearrl-iql": FormRow(
        title="DEARRL (IQL)",
        color="#56B4E9",
        line=(0, (3, 1, 1, 1, 1, 1)),
    ),
}
"""By name, in the order of tables and legends."""
