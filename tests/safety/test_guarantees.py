"""Expected survival, the one-step bound and the guarantee for episodes."""

import math
from fractions import Fraction

import numpy as np
import pytest

from dead_ends.envs.lifegate import DEAD_ENDS, lifegate
from dead_ends.labels.classification import classify
from dead_ends.model.safe_mdp import SafeMDP
from dead_ends.safety.guarantees import (
    EpisodeGuarantee,
    episode_guarantee,
    expected_survival,
    one_step_risk,
)
from dead_ends.safety.policies import greedy_actions
from dead_ends.values.bellman import evaluate_policy, value_iteration
from dead_ends.values.conventions import CriticConvention, ValueConvention
from proofs_check.machinery import oracles
from proofs_check.machinery.random_models import (
    random_deterministic,
    random_policy,
    random_stochastic,
    rounded,
)


def leaky(p: Fraction) -> SafeMDP:
    """State 0 fails with probability p, or stays; 1 fails."""
    P = np.full((2, 1, 2), Fraction(0), dtype=object)
    P[0, 0] = [1 - p, p]
    return SafeMDP.stochastic(P, np.array([False, True]))


# Expected survival


@pytest.mark.parametrize("p", [Fraction(1, 3), Fraction(1, 10**6), Fraction(1)])
def test_a_leak_is_survived_one_over_p_steps(p: Fraction) -> None:
    exact = expected_survival(leaky(p), exact=True)
    assert list(exact.time) == [1 / p, 0]
    assert exact.horizon == 1 / p
    floats = expected_survival(rounded(leaky(p)))
    assert Fraction(floats.lower[0]) <= 1 / p <= Fraction(floats.upper[0])
    assert floats.upper[0] - floats.lower[0] <= 1e-8 / float(p)
    assert floats.lower[0] <= floats.time[0] <= floats.upper[0]


def test_lifegate_dead_ends_are_survived_for_their_distance_over_the_push() -> None:
    model = lifegate()
    survival = expected_survival(model, exact=True)
    assert model.state_names is not None
    for x, y in DEAD_ENDS:
        state = model.state_names.index(f"x {x}, y {y}")
        assert survival.time[state] == Fraction(9 - x) / Fraction(7, 10)
    assert survival.horizon == 4 / Fraction(7, 10)


def test_the_slower_way_counts() -> None:
    """From 0 to 1 at once, or with probability 1/10; 1 fails with 1/2, or with 1/5."""
    P = np.full((3, 2, 3), Fraction(0), dtype=object)
    for s, a, p in (
        (0, 0, 1),
        (0, 1, Fraction(1, 10)),
        (1, 0, Fraction(1, 2)),
        (1, 1, Fraction(1, 5)),
    ):
        P[s, a, s + 1], P[s, a, s] = Fraction(p), 1 - Fraction(p)
    model = SafeMDP.stochastic(P, np.array([False, False, True]))
    assert list(expected_survival(model, exact=True).time) == [15, 5, 0]
    floats = expected_survival(rounded(model))
    assert (floats.lower <= [15, 5, 0]).all()
    assert (floats.upper >= [15, 5, 0]).all()
    np.testing.assert_allclose(floats.time, [15, 5, 0], rtol=1e-12)


def test_expected_survival_is_the_greatest_over_all_policies() -> None:
    rng = np.random.default_rng(1)
    dead = 0
    for _ in range(60):
        model = random_stochastic(rng, max_states=5, max_actions=2)
        exact = expected_survival(model, exact=True)
        floats = expected_survival(rounded(model))
        labelling = classify(model)
        dead += int(labelling.dead.sum())
        for state, truth in enumerate(oracles.greatest_expected_time(model)):
            if truth is None:
                assert exact.time[state] == floats.time[state] == math.inf
            else:
                assert exact.time[state] == truth
                assert Fraction(floats.lower[state]) <= truth <= Fraction(floats.upper[state])
    assert dead > 30


def test_deterministic_survival_is_t() -> None:
    rng = np.random.default_rng(2)
    for _ in range(20):
        model = random_deterministic(rng)
        labelling = classify(model)
        survival = expected_survival(model)
        assert survival.exact
        assert survival.horizon == labelling.horizon
        finite = labelling.dead | labelling.fail
        np.testing.assert_array_equal(survival.time[finite], labelling.survival_time[finite])
        assert np.isinf(survival.time[~finite]).all()


def test_unreached_tolerance_names_the_state() -> None:
    with pytest.raises(ValueError, match="the value of state 0 is only known to lie in"):
        expected_survival(rounded(leaky(Fraction(1, 3))), tolerance=1e-17, max_iterations=3)


# Bounds on values


def test_jensens_bound_and_the_one_step_bound() -> None:
    rng = np.random.default_rng(3)
    informative = 0
    for _ in range(80):
        model = random_stochastic(rng)
        survival = expected_survival(model, exact=True)
        labelling = classify(model)
        gamma = Fraction(9, 10)
        time_values = value_iteration(model, gamma, value=ValueConvention.TIME).V
        below = survival.discounted(gamma)
        for s in np.flatnonzero(labelling.dead | labelling.fail):
            assert Fraction(below[s]) <= time_values[s]
            truth = 0.9 ** float(survival.time[s])
            assert below[s] == pytest.approx(truth, rel=1e-12)
        assert (below[labelling.paper_safe] == 0).all()
        values = value_iteration(rounded(model), 0.9)
        risk = one_step_risk(values, survival)
        lost = (labelling.dead | labelling.fail).astype(float)
        kernel = model.transitions()
        truth = np.asarray(kernel @ lost).reshape(risk.shape)
        available = model.available
        assert (truth[available] <= risk[available] + 1e-15).all()
        assert np.isinf(risk[~available]).all()
        informative += int(((truth < risk) & (risk < 1))[available].sum())
    assert informative > 20


def test_bounds_need_the_right_convention() -> None:
    model = rounded(leaky(Fraction(1, 3)))
    survival = expected_survival(model)
    same = one_step_risk(
        value_iteration(model, value=ValueConvention.TIME, critic=CriticConvention.NEXT_VALUE),
        survival,
    )
    np.testing.assert_allclose(same, one_step_risk(value_iteration(model), survival))
    wrong = value_iteration(model, 1.0, critic=CriticConvention.NEXT_VALUE)
    with pytest.raises(ValueError, match="'cost-fail-0' with critic 'next-value'"):
        one_step_risk(wrong, survival)
    with pytest.raises(ValueError, match="'cost-fail-0' with critic 'next-value'"):
        episode_guarantee(wrong, 0.1, 0)


# Episodes


def worst_survival(
    model: SafeMDP, executed: list[list[list[int]]], steps: int
) -> list[list[Fraction]]:
    """min over task policies, also history-dependent, of P(no failure in n steps), n = 0..N.

    ``executed[s]`` lists what may be executed for each proposal; a recovery action is as bad as
    the worst of its ties.
    """
    kernel, probabilities = model.transitions(), model.exact_probabilities()
    alive = [Fraction(0 if f else 1) for f in model.fail]
    table = [alive]
    for _ in range(steps):
        alive = [
            Fraction(0)
            if model.fail[s]
            else min(
                sum(
                    (
                        probabilities[i] * alive[kernel.indices[i]]
                        for i in range(*kernel.indptr[s * model.num_actions + a :][:2])
                    ),
                    Fraction(0),
                )
                for proposals in executed[s]
                for a in proposals
            )
            for s in range(model.num_states)
        ]
        table.append(alive)
    return table


def test_guarantee_holds_against_every_task_policy() -> None:
    rng = np.random.default_rng(4)
    checked = tight = 0
    for _ in range(60):
        model = random_stochastic(rng, max_states=5)
        base = random_policy(rng, model)
        for best in (True, False):
            X = (
                value_iteration(model, Fraction(1))
                if best
                else evaluate_policy(model, base, Fraction(1))
            )
            greedy = greedy_actions(X) if best else np.asarray(base > 0)
            for epsilon in (Fraction(0), Fraction(1, 10), Fraction(1, 2), Fraction(1)):
                executed = []
                for s in range(model.num_states):
                    actions = np.flatnonzero(model.available[s])
                    allowed = [int(a) for a in actions if X.Q[s, a] < epsilon]
                    if len(allowed) == len(actions):
                        executed.append([allowed])
                    elif best:
                        executed.append([allowed, [int(a) for a in np.flatnonzero(greedy[s])]])
                    else:
                        executed.append([allowed])
                if not best and any(not e[0] for e in executed):
                    continue  # recovery is then a random action: left to the other case
                table = worst_survival(model, executed, 4)
                for s in np.flatnonzero(~model.fail):
                    guarantee = episode_guarantee(X, epsilon, int(s))
                    for n in range(5):
                        assert guarantee.probability(n) <= table[n][s]
                        checked += 1
                        tight += guarantee.probability(n) == table[n][s] and n > 1
    assert checked > 3000
    assert tight > 300


def test_guarantee_is_sharp() -> None:
    """0: stay, or risk p < eps: for p -> eps the survival is (1 - p)^N."""
    p, epsilon = Fraction(999, 10_000), Fraction(1, 10)
    P = np.full((2, 2, 2), Fraction(0), dtype=object)
    P[0, 0] = [Fraction(1), Fraction(0)]
    P[0, 1] = [1 - p, p]
    model = SafeMDP.stochastic(P, np.array([False, True]), initial=0)
    guarantee = episode_guarantee(value_iteration(model, Fraction(1)), epsilon)
    assert guarantee == EpisodeGuarantee(epsilon, 1 - epsilon)
    for n in (1, 5, 20):
        assert guarantee.probability(n) <= float((1 - p) ** n)
        assert guarantee.probability(n) == pytest.approx(0.9**n, rel=1e-15)


def test_simulated_episodes_survive_as_often_as_guaranteed() -> None:
    """Slippery way to a goal; the task policy is random, the filter at 0.05."""
    P = np.zeros((5, 2, 5))
    for s in range(3):
        P[s, 0, s], P[s, 0, s + 1] = 0.5, 0.5  # careful
        P[s, 1, s + 1], P[s, 1, 4] = 0.96, 0.04  # hasty
    model = SafeMDP.stochastic(P, np.arange(5) == 4, terminal=np.arange(5) == 3, initial=[0])
    X = value_iteration(model, 1.0)
    guarantee = episode_guarantee(X, 0.05)
    allowed = np.asarray(X.Q_upper < 0.05)
    recovery = X.Q.argmin(axis=1)
    rng = np.random.default_rng(7)
    episodes, steps, survived = 4000, 3, 0
    kernel = model.transitions().toarray().reshape(5, 2, 5)
    for _ in range(episodes):
        state = 0
        for _ in range(steps):
            proposed = 1  # always hasty
            action = proposed if allowed[state, proposed] else recovery[state]
            state = int(rng.choice(5, p=kernel[state, action]))
            if state in (3, 4):
                break
        survived += state != 4
    deviation = 4 * math.sqrt(0.25 / episodes)
    assert survived / episodes >= guarantee.probability(steps) - deviation
    assert survived / episodes == pytest.approx(0.96**3, abs=deviation)


def test_initial_distribution_is_averaged() -> None:
    P = np.full((4, 1, 4), Fraction(0), dtype=object)
    P[0, 0, 0] = Fraction(1)
    P[1, 0, 0] = P[1, 0, 2] = Fraction(1, 2)
    P[2, 0, 3] = Fraction(1)
    model = SafeMDP.stochastic(P, np.arange(4) == 3, initial=[0.25, 0.25, 0.25, 0.25])
    X = value_iteration(model, Fraction(1))
    guarantee = episode_guarantee(X, Fraction(1, 10))
    assert guarantee.start == (Fraction(9, 10) + Fraction(1, 2) + 0 + 0) / 4


@pytest.mark.parametrize("confidence", [0.99, 0.9, 0.5, 1e-3, Fraction(2, 3)])
@pytest.mark.parametrize("epsilon", [0.5, 0.1, 0.01, 1e-6, 1e-40, Fraction(1, 3)])
def test_steps_are_the_most_that_reach_the_confidence(
    epsilon: float | Fraction, confidence: float | Fraction
) -> None:
    guarantee = EpisodeGuarantee(Fraction(str(epsilon)), 1 - Fraction(str(epsilon)))
    steps = guarantee.steps(confidence)
    wanted = float(confidence)
    assert isinstance(steps, int)
    if steps == 0:
        assert 1 - float(epsilon) < wanted
        return
    closed = math.log(wanted) / math.log1p(-float(epsilon))
    assert steps == pytest.approx(closed, rel=1e-9, abs=1)
    if steps < 10**6:
        keep = 1 - Fraction(str(epsilon))
        assert keep**steps >= Fraction(str(confidence)) if steps < 500 else True
        assert guarantee.probability(steps + 1) < wanted


def test_steps_at_the_edge_are_exact() -> None:
    guarantee = EpisodeGuarantee(Fraction(1, 10), Fraction(9, 10))
    assert guarantee.steps(0.81) == 2
    assert guarantee.steps(Fraction(81, 100) + Fraction(1, 10**30)) == 1
    assert guarantee.steps(0.9) == 1
    assert guarantee.steps(0.95) == 0
    assert guarantee.steps(0) == math.inf
    assert guarantee.probability(0) == 1
    assert EpisodeGuarantee(Fraction(0), Fraction(3, 4)).steps(0.75) == math.inf
    assert EpisodeGuarantee(Fraction(0), Fraction(3, 4)).steps(0.76) == 0
    assert EpisodeGuarantee(Fraction(1), Fraction(0)).steps(0.1) == 0
    assert EpisodeGuarantee(Fraction(1, 10), Fraction(9, 10)).probability(10**9) == 0


def test_errors_of_the_guarantee() -> None:
    model = rounded(leaky(Fraction(1, 3)))
    X = value_iteration(model, 1.0)
    with pytest.raises(ValueError, match=r"needs gamma_safe = 1, not 0\.99"):
        episode_guarantee(value_iteration(model, 0.99), 0.1, 0)
    with pytest.raises(ValueError, match=r"epsilon_safe must lie in \[0, 1\], not 1\.5"):
        episode_guarantee(X, 1.5, 0)
    with pytest.raises(ValueError, match="no initial states; name the first state"):
        episode_guarantee(X, 0.1)
    with pytest.raises(ValueError, match=r"there is no state 2 \(0 to 1\)"):
        episode_guarantee(X, 0.1, 2)
    guarantee = episode_guarantee(X, 0.1, 0)
    with pytest.raises(ValueError, match=r"confidence must lie in \[0, 1\], not 2"):
        guarantee.steps(2)
    with pytest.raises(ValueError, match="steps must not be negative, not -1"):
        guarantee.probability(-1)


def test_no_risk_is_bounded_by_numbers_that_underflow() -> None:
    """An action that surely enters a state with T = 1200: gamma**1200 is no float."""
    n = 1200
    after = np.minimum(np.arange(n + 2) + 1, n + 1)
    table = np.stack([after, after], axis=1)
    table[0, 0] = 0
    model = SafeMDP.deterministic(table, np.arange(n + 2) == n + 1)
    survival = expected_survival(model)
    for gamma in (0.5, Fraction(1, 2)):
        assert one_step_risk(value_iteration(model, gamma), survival)[0].tolist() == [0, 1]
    # Here the power is a subnormal float, half of which may be rounding.
    risk = one_step_risk(value_iteration(model, 0.5377), survival)
    assert risk[0].tolist() == [0, 1]


def test_a_risk_below_every_float_is_not_rounded_to_none_by_underflow() -> None:
    """State 0 may enter the dead state 1 with a probability that no float can be as small as."""
    p = Fraction(1, 2) ** 1100
    P = np.full((3, 2, 3), Fraction(0), dtype=object)
    P[0, 0, 0] = Fraction(1)
    P[0, 1, 1], P[0, 1, 0] = p, 1 - p
    P[1, :, 2] = Fraction(1)
    model = SafeMDP.stochastic(P, np.array([False, False, True]))
    risk = one_step_risk(value_iteration(model, Fraction(1, 2)), expected_survival(model))
    assert risk[0, 0] == 0
    assert p <= risk[0, 1] < 1e-300
