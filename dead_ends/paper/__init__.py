"""The paper's statements as predicates, and a report of them on one model.

    predicates    one function a statement: arrays in, a mask of the places where it fails out
    verification  which statements hold on a given model, with the numbers

`python -m dead_ends statements FILE` prints the report.
"""

from dead_ends.paper.predicates import (
    allowed_inclusion,
    assumption_1,
    bellman_equation,
    below_power,
    boundary_exact,
    corrected_loop,
    definition_2,
    executed_actions,
    leaves,
    lemma_1_dead,
    lemma_1_fail,
    lemma_1_safe,
    one_step_bound,
    policy_stays,
    positive_exactly,
    survival_bound,
    time_bound,
    unsafe_allowed,
    unsafe_minimisers,
)
from dead_ends.paper.verification import Statement, Verification, verify_statements

__all__ = [
    "Statement",
    "Verification",
    "allowed_inclusion",
    "assumption_1",
    "bellman_equation",
    "below_power",
    "boundary_exact",
    "corrected_loop",
    "definition_2",
    "executed_actions",
    "leaves",
    "lemma_1_dead",
    "lemma_1_fail",
    "lemma_1_safe",
    "one_step_bound",
    "policy_stays",
    "positive_exactly",
    "survival_bound",
    "time_bound",
    "unsafe_allowed",
    "unsafe_minimisers",
    "verify_statements",
]
