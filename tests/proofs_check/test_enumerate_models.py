"""The enumeration: nothing is missing, nothing is counted twice, T is what brute force says."""

from __future__ import annotations

from itertools import permutations
from math import comb, factorial

import numpy as np
import pytest

from dead_ends import SafeMDP
from proofs_check.machinery import enumerate_models as em
from proofs_check.machinery import oracles

SIZES = [(1, 2), (2, 2), (3, 2), (4, 2), (5, 2), (2, 3), (3, 3), (4, 3)]


@pytest.mark.parametrize(("n", "m"), SIZES)
def test_every_model_is_met_once(n: int, m: int) -> None:
    digits = (n - 1) * m
    seen = np.zeros(em.count(n, m), dtype=np.int64)
    for batch in em.batches(n, m, size=10_000):
        assert batch.shape[1:] == (n - 1, m)
        assert batch.min(initial=0) >= 0
        assert batch.max(initial=0) < n
        codes = batch.reshape(len(batch), -1).astype(np.int64) @ n ** np.arange(digits)[::-1]
        np.add.at(seen, codes, 1)
    assert (seen == 1).all()


def test_counts_are_those_known() -> None:
    assert em.count(4, 2) == 4_096
    assert em.count(4, 3) == 262_144
    assert em.count(5, 2) == 390_625
    assert em.count(6, 2) == 60_466_176


@pytest.mark.parametrize(("n", "m"), [(1, 1), (1, 2), (2, 2), (3, 2), (4, 2), (3, 3)])
def test_merging_fail_states_covers_every_fail_set(n: int, m: int) -> None:
    """sum over k and over merged models of C(n, k) k^j is the number of all models."""
    total = sum(
        comb(n, k) * em.multiplicities(batch, k)
        for k in range(n + 1)
        for batch in em.batches(n - k + 1, m)
    )
    assert total == em.count_all(n, m)


def test_count_all_by_listing() -> None:
    """n = 2, m = 1: no fail state 4 tables, one fail state 2 x 2, both 1."""
    assert em.count_all(2, 1) == 4 + 4 + 1


@pytest.mark.parametrize(("n", "m"), [(2, 2), (3, 2), (3, 3), (4, 2)])
def test_survival_agrees_with_brute_force(n: int, m: int) -> None:
    for batch in em.batches(n, m):
        times, policy = em.survival(batch), em.policy_time(batch)
        for table, time, under in list(zip(batch, times, policy, strict=True))[::7]:
            model = SafeMDP.deterministic(
                np.vstack([table, np.zeros(m, int)]), np.arange(n) == n - 1
            )
            expected = oracles.survival_times(model)
            assert [None if t == em.FOREVER else t for t in time] == expected
            walk = [*table[:, 0], 0]
            steps = [oracles.steps_to_fail(walk, {n - 1}, s) for s in range(n)]
            assert [None if t == em.FOREVER else t for t in under] == steps


@pytest.mark.parametrize(("n", "m"), [(2, 2), (3, 2), (4, 2), (5, 2), (3, 3), (4, 3)])
def test_classes_add_up_to_all_models(n: int, m: int) -> None:
    codes, sizes = em.representatives(n, m)
    assert sizes.sum() == em.count(n, m)
    assert len(codes) == burnside(n, m)
    assert len(np.unique(codes)) == len(codes)


def burnside(n: int, m: int) -> int:
    """Classes = mean number of models that a renaming leaves alone.

    It leaves a model alone if next(r(s), a) = r(next(s, a)): along a cycle of r of length l,
    next(s, a) is free among the states that r^l fixes and the others follow.
    """
    total = 0
    for order in permutations(range(n - 1)):
        renaming = (*order, n - 1)
        product, seen = 1, set()
        for s in range(n - 1):
            if s in seen:
                continue
            length, t = 0, s
            while t not in seen:
                seen.add(t)
                t, length = renaming[t], length + 1
            product *= sum(power(renaming, length, u) == u for u in range(n)) ** m
        total += product
    return total // factorial(n - 1)


def power(renaming: tuple[int, ...], exponent: int, state: int) -> int:
    for _ in range(exponent):
        state = renaming[state]
    return state


def test_class_of_a_representative_by_renaming() -> None:
    """n = 4, m = 2: the renamed tables of each class are disjoint and fill its size."""
    codes, sizes = em.representatives(4, 2)
    seen: set[tuple[int, ...]] = set()
    for table, size in zip(em.tables(4, 2, codes), sizes, strict=True):
        orbit = set()
        for order in permutations(range(3)):
            renaming = np.array([*order, 3])
            renamed = np.empty_like(table)
            renamed[renaming[:3]] = renaming[table]
            orbit.add(tuple(renamed.ravel().tolist()))
        assert len(orbit) == size
        assert min(orbit) == tuple(table.ravel().tolist())
        assert not orbit & seen
        seen |= orbit


def test_side_by_side_keeps_models_apart() -> None:
    batch = next(em.batches(3, 2))
    model = em.side_by_side(batch)
    assert model.num_states == 3 * len(batch)
    successors = model.successors().reshape(len(batch), 3, 2)
    assert np.array_equal(model.fail.reshape(-1, 3), np.tile([False, False, True], (len(batch), 1)))
    for b in (0, 17, len(batch) - 1):
        assert np.array_equal(successors[b, :2] - 3 * b, batch[b])


@pytest.mark.parametrize(("n", "total"), [(1, 3), (2, 4), (3, 4), (4, 2)])
def test_distributions_are_all_compositions(n: int, total: int) -> None:
    found = em.distributions(n, total)
    assert len(found) == len(set(found)) == comb(total + n - 1, n - 1)
    assert all(sum(parts) == total and min(parts) >= 0 for parts in found)
