"""The paper's methods, conventions, readings and objectives, and its statements as predicates.

    methods       RRL, RRL (MSDP), DEA-RRL and its expectile form in tabular form
    predicates    one function a statement: arrays in, a mask of the places where it fails out
    verification  which statements hold on a given model, with the numbers

The conventions of V_c and Q_c, the readings of the policy set, the expectile critic and the
paper's objectives are defined where they are used, and are here by the same names.

`python -m dead_ends statements FILE` prints the report.
"""

from dead_ends.paper.methods import (
    Conservatism,
    Method,
    conservatism,
    dea_rrl,
    dea_rrl_expectile,
    rrl,
    rrl_msdp,
)
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
from dead_ends.safety.planning import PlanResult, PriceOfConservatism, plan, price_of_conservatism
from dead_ends.safety.policies import Reading, in_policy_set
from dead_ends.values.conventions import CriticConvention, ValueConvention
from dead_ends.values.expectile import expectile_iteration

__all__ = [
    "Conservatism",
    "CriticConvention",
    "Method",
    "PlanResult",
    "PriceOfConservatism",
    "Reading",
    "Statement",
    "ValueConvention",
    "Verification",
    "allowed_inclusion",
    "assumption_1",
    "bellman_equation",
    "below_power",
    "boundary_exact",
    "conservatism",
    "corrected_loop",
    "dea_rrl",
    "dea_rrl_expectile",
    "definition_2",
    "executed_actions",
    "expectile_iteration",
    "in_policy_set",
    "leaves",
    "lemma_1_dead",
    "lemma_1_fail",
    "lemma_1_safe",
    "one_step_bound",
    "plan",
    "policy_stays",
    "positive_exactly",
    "price_of_conservatism",
    "rrl",
    "rrl_msdp",
    "survival_bound",
    "time_bound",
    "unsafe_allowed",
    "unsafe_minimisers",
    "verify_statements",
]
