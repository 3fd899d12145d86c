"""On a tabular model, given as one-hot features, each form finds its own tabular answer.

The model is the counterexample to the paper's claim about RRL: P: (d2, q), q: (fail, q),
d2 -> d1 -> fail, and a task policy that always takes the first action.
"""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from dead_ends import SafeMDP, evaluate_policy, value_iteration
from dead_ends.paper import expectile_iteration
from deep.data.minibatches import Batches
from deep.data.transitions import Transitions
from deep.pretraining import (
    DeaRrl,
    DeaRrlAnnealed,
    DeaRrlAnnealedSettings,
    DearrlIql,
    DearrlIqlSettings,
    DeaRrlSettings,
    Learner,
    Rrl,
    RrlMsdp,
    RrlMsdpSettings,
    RrlSettings,
    Sizes,
)

GAMMA = 0.9
P, Q, D2, D1, FAIL = range(5)
NEXT = np.array([[D2, Q], [FAIL, Q], [D1, D1], [FAIL, FAIL], [FAIL, FAIL]])
MODEL = SafeMDP.deterministic(NEXT, np.arange(5) == FAIL)
UNIFORM = np.full((5, 2), 0.5)
SIZES = Sizes(5, 1)
COMMON = {
    "gamma_safe": GAMMA,
    "hidden": (32, 32),
    "learning_rate": 3e-3,
    "batch_size": 64,
    "polyak": 0.05,
    "members": 1,
    "violation_share": None,
    "entropy_weight": 0.0,
}


def every_transition() -> Transitions:
    """Every state with 16 numbers from -1 to 1: action 0 below 0, action 1 above."""
    numbers = np.linspace(-1, 1, 16)
    state, number = (grid.ravel() for grid in np.meshgrid(range(4), numbers, indexing="ij"))
    following = NEXT[state, (number > 0).astype(int)]
    cost = following == FAIL
    return Transitions(
        observations=np.eye(5)[state],
        actions=number[:, None],
        next_observations=np.eye(5)[following],
        rewards=np.zeros(len(state)),
        costs=cost,
        terminals=cost,
        timeouts=~cost,
    )


def learn(learner: Learner, updates: int) -> tuple[np.ndarray, np.ndarray]:
    """Q (4, 2), and which action the recovery policy takes (4,), as 0 or 1."""
    batches = Batches([every_transition()], learner.seeds, 64, None, torch.device("cpu"))
    for update in range(updates):
        learner.update(batches.get(update), update / updates)
    states = torch.eye(5)[:4].unsqueeze(0)
    with torch.no_grad():
        columns = [learner.critic.worst(states, torch.full((1, 4, 1), a)) for a in (-1.0, 1.0)]
        recovery = learner.recovery.mean_action(states)[0, :, 0]
    return torch.stack(columns, dim=-1)[0].numpy(), (recovery.numpy() > 0).astype(int)


def test_dea_rrl_learns_the_expectile_critic_and_its_greedy_recovery() -> None:
    # With entropy: without it the policy may settle while the critic is still wrong.
    settings = DeaRrlSettings(**(COMMON | {"entropy_weight": 0.2}), expectile=0.3)
    q, recovery = learn(DeaRrl(settings, SIZES, (0,)), 2000)
    expected = expectile_iteration(MODEL, UNIFORM, 0.3, GAMMA).Q[:4]
    assert q == pytest.approx(expected, abs=0.02)
    # It is not Q*: the safe action of q is worth 0 there.
    assert q[Q, 1] > 0.5
    assert recovery[[P, Q]].tolist() == [1, 1]


def test_dearrl_iql_learns_the_same_critic_and_the_best_data_action() -> None:
    q, recovery = learn(DearrlIql(DearrlIqlSettings(**COMMON, expectile=0.3), SIZES, (0,)), 2000)
    assert q == pytest.approx(expectile_iteration(MODEL, UNIFORM, 0.3, GAMMA).Q[:4], abs=0.02)
    assert recovery[[P, Q]].tolist() == [1, 1]


def test_rrl_learns_the_task_policys_critic_and_steps_into_the_dead_end() -> None:
    def first_action(observation: Tensor, _: Tensor) -> Tensor:
        return torch.full((*observation.shape[:2], 1), -1.0)

    q, recovery = learn(Rrl(RrlSettings(**COMMON), SIZES, (0,), first_action), 1500)
    expected = evaluate_policy(MODEL, np.zeros(5, dtype=int), GAMMA).Q[:4]
    assert q == pytest.approx(expected, abs=0.02)
    # P: into d2 (gamma^2) rather than to q, where the task policy would fail (gamma).
    assert recovery[[P, Q]].tolist() == [0, 1]


def test_rrl_msdp_learns_the_best_critic_and_stays_safe() -> None:
    q, recovery = learn(RrlMsdp(RrlMsdpSettings(**COMMON), SIZES, (0,)), 1800)
    assert q == pytest.approx(value_iteration(MODEL, GAMMA).Q[:4], abs=0.03)
    assert recovery[[P, Q]].tolist() == [1, 1]


def test_the_annealed_form_ends_at_its_last_expectile_near_the_best_critic() -> None:
    settings = DeaRrlAnnealedSettings(**COMMON, final_expectile=0.01)
    q, recovery = learn(DeaRrlAnnealed(settings, SIZES, (0,)), 1800)
    assert q == pytest.approx(expectile_iteration(MODEL, UNIFORM, 0.01, GAMMA).Q[:4], abs=0.03)
    assert np.abs(q - value_iteration(MODEL, GAMMA).Q[:4]).max() < 0.15
    assert recovery[[P, Q]].tolist() == [1, 1]
