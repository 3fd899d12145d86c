"""Scores: the oracle is perfect, hand-made critics get the scores that follow by hand."""

from __future__ import annotations

import csv
import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from deep.data.collect import random_policy, towards_obstacle_policy
from deep.pretraining import DeaRrlAnnealedSettings
from deep.score.boundary import (
    LearnedFilter,
    OracleFilter,
    action_grid,
    box_points,
    closed_loop,
    critic_table,
    safe_starts,
    score_boundary,
)
from deep.score.compare import CompareConfig, Interval, compare, interval, summary_table
from deep.score.demo import DemoConfig, demo
from deep.score.exact_answers import (
    ExactAnswer,
    enclosed_point,
    exact_answer,
    oracle_allows,
    oracle_blocks,
    tabular_brake_dead,
    tabular_double_integrator,
)
from deep.score.figures import SweepScore, sweep_figure
from deep.score.sweep import _runs
from deep.tasks import (
    Brake,
    DoubleIntegrator,
    Dubins,
    Navigation,
    PointAmongDiscs,
    make_task,
)
from tests.deep import filters

TASKS = (Brake(), DoubleIntegrator())


def answers() -> list[ExactAnswer]:
    return [exact_answer(task) for task in TASKS]


@pytest.mark.parametrize(
    "task", [Brake(), Brake(max_distance=40.0, max_speed=9.0, acceleration=1.0)], ids=repr
)
def test_the_brakes_closed_form_is_the_tabular_answer(task: Brake) -> None:
    states, dead = tabular_brake_dead(task)
    assert dead.sum() > 30
    assert np.array_equal(task.dead(states), dead)
    with pytest.raises(ValueError, match="are not integers"):
        tabular_brake_dead(Brake(acceleration=1.5))


def test_the_double_integrators_closed_form_lies_in_the_tabular_brackets() -> None:
    task = DoubleIntegrator()
    corners, width, inner, outer = tabular_double_integrator(task, 4)
    box = np.abs(corners[:, 1] + width[1] / 2) < task.max_speed
    rng = np.random.default_rng(0)
    for _ in range(20):
        points = corners + width * rng.random(corners.shape)
        dead = task.dead(points)
        assert not dead[inner & box].any()
        assert dead[~outer & box].all()
    assert (inner & box).sum() > 0.95 * (outer & box).sum()  # the brackets are narrow
    with pytest.raises(ValueError, match="the gap is 22.2222 units"):
        tabular_double_integrator(DoubleIntegrator(dt=0.3), 2)


def test_the_dubins_car_is_enclosed() -> None:
    task = Dubins()
    answer = exact_answer(task)
    rng = np.random.default_rng(0)
    points = box_points(answer, 3000, 3, 0.05, rng)
    assert 0 < points.gap < 0.2
    assert 0.02 < points.dead.mean() < 0.98
    # Brute force over all sequences of the three commands: dead within H steps, or not.
    dead, safe = points.state[points.dead][:150], points.state[~points.dead][:150]
    depth = min(answer.horizon, 7)
    alive = {True: np.zeros(len(dead), dtype=bool), False: np.zeros(len(safe), dtype=bool)}
    for sequence in itertools.product((-1.0, 0.0, 1.0), repeat=depth):
        for lost, state in ((True, dead), (False, safe)):
            running, lives = state, np.ones(len(state), dtype=bool)
            for action in sequence:
                step = task.step(running, np.full((len(running), 1), action), rng)
                lives &= ~step.violation
                running = step.next_state
            alive[lost] |= lives
    assert alive[False].all()
    if depth == answer.horizon:
        assert not alive[True].any()
    # A certainly safe state has a command to a certainly safe state: no failure, for ever.
    state = points.state[~points.dead]
    for _ in range(50):
        allowed = [
            oracle_allows(answer, state, np.full((len(state), 1), a)) for a in points.action[:, 0]
        ]
        assert np.any(allowed, axis=0).all()
        action = points.action[np.argmax(allowed, axis=0)]
        step = task.step(state, action, rng)
        assert not step.violation.any()
        state = step.next_state
    with pytest.raises(ValueError, match="the square's side 6.5 is no whole number"):
        exact_answer(Dubins(half_width=3.25))


def test_the_point_is_enclosed() -> None:
    task = PointAmongDiscs()
    answer = enclosed_point(task, 1)
    rng = np.random.default_rng(0)
    points = box_points(answer, 6000, 3, 0.05, rng)
    assert 0 < points.gap < 0.12
    assert 0.05 < points.dead.mean() < 0.3
    # Full braking, which many of the safe states can rely on, saves no dead one.
    state, alive = points.state, np.ones(len(points.state), dtype=np.bool_)
    for _ in range(6):
        action = np.clip(-state[:, 2:] / (task.acceleration * task.dt), -1, 1)
        step = task.step(state, action, rng)
        alive &= ~step.violation
        state = step.next_state
    assert not (alive & points.dead).any()
    assert alive[~points.dead].mean() > 0.9
    # Nor do any of the actions of the grid lead from a dead state to a safe one.
    assert points.unsafe[points.dead].any()
    assert not points.fine[points.dead].any()
    fails = np.zeros((1, 4))
    assert not answer.dead(fails)[0]
    assert not answer.safe(fails)[0]


def test_compare_scores_the_point_outside_the_gap(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("deep.score.exact_answers.POINT_RESOLUTION", 1)
    config = CompareConfig(
        task="point",
        out=tmp_path / "run",
        methods=("dea-rrl-annealed",),
        seeds=(0,),
        updates=3,
        transitions=300,
        points=300,
        actions=3,
        episodes=20,
        task_policy_steps=256,
    )
    scores = compare(config, quiet=True)
    assert {score.method for score in scores} == {"dea-rrl-annealed"}  # no oracle in the gap
    assert "between the enclosing sets" in (tmp_path / "run" / "summary.md").read_text()
    assert (tmp_path / "run" / "boundary.png").stat().st_size > 10_000


@pytest.mark.parametrize("name", ["navigation1", "navigation2"])
def test_navigation_has_no_dead_ends(name: str) -> None:
    task = make_task(name)
    assert isinstance(task, Navigation)
    answer = exact_answer(task)
    rng = np.random.default_rng(0)
    points = box_points(answer, 20_000, 3, 0.05, rng)
    assert (answer.horizon, points.gap, points.dead.any()) == (0, 0, False)
    assert oracle_allows(answer, points.state, task.safest_action(points.state)).all()
    # The hardest places: just outside the corners and edges of each obstacle.
    corners = [[x, y] for r in task.obstacles for x in (r.left, r.right) for y in (r.bottom, r.top)]
    state = (np.array(corners)[:, None] + rng.uniform(-2, 2, (500, 2))).reshape(-1, 2)
    state = np.clip(state, task.low, task.high)[answer.safe(state)]
    assert oracle_allows(answer, state, task.safest_action(state)).all()
    # Fine and unsafe are what a thousand draws say; in between, both happen.
    state, action = state[:800], rng.uniform(-1, 1, (800, 2))
    hits = sum(task.step(state, action, rng).violation.astype(int) for _ in range(1000))
    fine, unsafe = oracle_allows(answer, state, action), oracle_blocks(answer, state, action)
    assert not hits[fine].any()
    assert (hits[unsafe] == 1000).all()
    assert ((hits > 0) & (hits < 1000)).any()
    assert unsafe.any()


@pytest.mark.parametrize("name", ["navigation1", "navigation2"])
def test_navigations_oracle_never_fails(name: str) -> None:
    task = make_task(name)
    assert isinstance(task, Navigation)
    answer = exact_answer(task)
    rng = np.random.default_rng(0)
    scored, starts = OracleFilter(answer, task), safe_starts(answer, 500, rng)
    points = box_points(answer, 2000, 5, 0.05, rng)
    score = score_boundary(critic_table(scored, points), 1.0, points)
    assert score.safe_called_dead == score.safe_actions_blocked == 0
    assert score.unsafe_actions_allowed == 0
    assert np.isnan(score.dead_called_safe)
    policy = towards_obstacle_policy(task)
    assert closed_loop(task, scored, policy, starts, rng).failures == 0
    assert closed_loop(task, None, policy, starts, rng).failures == 500


def test_tasks_without_an_exact_answer_are_refused() -> None:
    with pytest.raises(ValueError, match="static-env: there is no exact answer"):
        exact_answer(make_task("static-env"))


@pytest.mark.parametrize("answer", answers(), ids=lambda a: a.task.name)
def test_the_oracle_is_exact_and_never_fails(answer: ExactAnswer) -> None:
    rng = np.random.default_rng(0)
    points = box_points(answer, 2000, 33, 0.05, rng)
    assert isinstance(answer.task, Brake | DoubleIntegrator)
    scored = OracleFilter(answer, answer.task)
    score = score_boundary(critic_table(scored, points), 1.0, points)
    assert score.dead_called_safe == score.near_dead_called_safe == 0
    assert score.safe_actions_blocked == score.unsafe_actions_allowed == 0
    # Safe states whose safe actions all lie between those of the grid: a thin sliver.
    assert score.safe_called_dead < 0.01
    starts = safe_starts(answer, 1000, rng)
    for policy in (random_policy(answer.task), towards_obstacle_policy(answer.task)):
        assert closed_loop(answer.task, scored, policy, starts, rng).failures == 0
        assert closed_loop(answer.task, None, policy, starts, rng).failures > 500


def test_the_oracle_blocks_what_leaves_the_safe_set() -> None:
    answer = exact_answer(Brake())
    state = np.array([[20.0, 8.0], [20.0, 8.0], [12.5, 8.0]])
    action = np.array([[-1.0], [1.0], [0.0]])
    # Full speed from 20 leaves 12 at speed 8: exactly the stopping distance, dead.
    assert oracle_blocks(answer, state, action).tolist() == [False, True, True]


def test_points_are_labelled_and_fixed() -> None:
    answer = exact_answer(Brake())
    points = box_points(answer, 500, 5, 0.05, np.random.default_rng(1))
    assert np.array_equal(points.dead, answer.dead(points.state))
    assert (points.unsafe[points.dead]).all()
    assert not points.unsafe[~points.dead].all(axis=1).all()
    assert np.array_equal(points.fine, ~points.unsafe)
    assert points.gap == 0
    assert answer.boundary_distance is not None
    distance = answer.boundary_distance(points.state)
    assert np.array_equal(points.near, distance <= 1.5)
    again = box_points(answer, 500, 5, 0.05, np.random.default_rng(1))
    assert np.array_equal(points.state, again.state)


def test_a_critic_of_distance_is_scored_as_by_hand() -> None:
    answer = exact_answer(Brake())
    points = box_points(answer, 4000, 5, 0.05, np.random.default_rng(1))
    # Q >= 1/2 iff the scaled distance is at most 0, distance <= 15, whatever the action.
    scored = LearnedFilter(Brake(), filters.linear_filter([-50.0, 0.0], 0.0, 0.0, -20.0))
    score = score_boundary(critic_table(scored, points), 0.5, points)
    assert score.dead_called_safe == 0  # the longest stopping distance is 12
    near = points.state[:, 0] <= 15
    assert score.safe_called_dead == (near & ~points.dead).sum() / (~points.dead).sum()
    allowed = points.unsafe[~points.dead & ~near].sum() / points.unsafe[~points.dead].sum()
    assert score.unsafe_actions_allowed == pytest.approx(allowed)
    # Full braking from more than 15 never fails, and that is what the filter does at 15.
    rng = np.random.default_rng(0)
    starts = np.array([[29.0, 8.0], [16.0, 2.0]])
    loop = closed_loop(Brake(), scored, random_policy(Brake()), starts, rng)
    assert (loop.episodes, loop.failures) == (2, 0)
    assert 0 < loop.interventions < 1


def test_a_share_of_nothing_is_no_number() -> None:
    answer = exact_answer(Brake())
    points = box_points(answer, 200, 3, 0.0, np.random.default_rng(0))
    score = score_boundary(np.zeros((len(points.state), 3), dtype=np.float32), 0.5, points)
    assert np.isnan(score.near_dead_called_safe)
    assert score.dead_called_safe == 1


def test_action_grids_are_dense_and_hold_the_ends() -> None:
    assert action_grid(1, 3)[:, 0].tolist() == [-1, 0, 1]
    grid = action_grid(2, 3)
    assert grid.shape == (9, 2)
    assert grid.min() == -1
    assert len(np.unique(grid, axis=0)) == 9


def test_intervals_hold_the_mean_and_shrink_to_it() -> None:
    spread = interval([0.0, 1.0, 0.0, 1.0])
    assert spread.low < spread.mean == 0.5 < spread.high
    same = interval([0.25] * 5)
    assert same.low == same.mean == same.high == 0.25
    assert interval([0.4]) == Interval(0.4, 0.4, 0.4)
    # The middle 95% of 2000 means of seeds that are drawn again.
    values = np.array([0.3, 0.9, 0.7, 0.2, 0.1])
    means = values[np.random.default_rng(103).integers(5, size=(2000, 5))].mean(axis=1)
    found = interval(list(values))
    assert [found.low, found.high] == pytest.approx(np.percentile(means, [2.5, 97.5]))


def test_compare_trains_scores_and_draws_every_method(tmp_path: Path) -> None:
    config = CompareConfig(
        task="double-integrator",
        out=tmp_path / "run",
        seeds=(0, 1),
        updates=3,
        transitions=300,
        points=300,
        actions=3,
        episodes=20,
        task_policy_steps=256,
    )
    scores = compare(config, quiet=True)
    assert {score.method for score in scores} == {
        "oracle", "dea-rrl-annealed", "dea-rrl", "dearrl-iql", "rrl", "rrl-msdp"
    }  # fmt: skip
    assert len(scores) == 1 + 5 * 2 * 2
    with (tmp_path / "run" / "scores.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(scores)
    assert float(rows[0]["adversarial_failures"]) == 0
    assert (tmp_path / "run" / "boundary.png").stat().st_size > 10_000
    table = (tmp_path / "run" / "summary.md").read_text()
    assert table == summary_table(scores)
    assert "| oracle | exact labels = 1.000 | 0.00 [0.00, 0.00] |" in table
    with pytest.raises(ValueError, match="methods must be some of rrl, rrl-msdp, "):
        replace(config, methods=("sac",))
    with pytest.raises(ValueError, match="holds a comparison with another configuration"):
        compare(replace(config, points=301), quiet=True)


def test_the_demo_draws_both_tasks(tmp_path: Path) -> None:
    scores = demo(DemoConfig(tmp_path / "demo", (0,), 5, 300), quiet=True)
    assert set(scores) == {"brake", "double-integrator"}
    assert (tmp_path / "demo" / "demo.png").stat().st_size > 10_000


def test_a_sweep_varies_one_thing_at_a_time() -> None:
    from deep.score.sweep import SweepConfig

    answer = exact_answer(Brake())
    runs = _runs(SweepConfig("brake", Path("unused")), answer)
    recipe = [run for name, value, run in runs if (name, value) == ("gamma_safe", 0.75)]
    assert len(recipe) == 1
    for name, value, run in runs:
        if name == "last expectile":
            assert isinstance(run.method, DeaRrlAnnealedSettings)
            assert run.method.final_expectile == value
        if name == "share of corner actions":
            assert (run.mix.corners, run.mix.random) == (value, 1 - value)
    figure = sweep_figure("brake", [SweepScore("gamma_safe", 0.5, 0, 0.0, 0.1)])
    assert isinstance(figure, Figure)
