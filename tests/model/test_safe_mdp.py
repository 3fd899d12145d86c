"""The model: what it accepts, what it refuses and how it says so."""

from __future__ import annotations

import re
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from scipy import sparse

from dead_ends import SafeMDP, value_iteration
from dead_ends.model.checks import ExactEntries
from dead_ends.model.safe_mdp import Geometry

FAIL_LAST = np.array([False, False, True])
CHAIN = np.array([[0, 1], [2, 2], [0, 0]], dtype=np.int32)


def uniform_kernel(num_states: int, num_actions: int) -> np.ndarray:
    return np.full((num_states, num_actions, num_states), 1 / num_states)


def test_an_int32_table_is_adopted_and_marked_read_only() -> None:
    table = CHAIN.copy()
    model = SafeMDP.deterministic(table, FAIL_LAST)
    assert model.next_state is table
    with pytest.raises(ValueError, match="read-only"):
        table[0, 0] = 1


@pytest.mark.parametrize("wrong", [{"rewards": [1.0]}, {"initial": 7}, {"state_names": ["a"]}])
def test_a_refused_table_stays_as_it_was(wrong: dict[str, object]) -> None:
    table = CHAIN.copy()
    with pytest.raises(ValueError, match=next(iter(wrong))):
        SafeMDP.deterministic(table, FAIL_LAST, **wrong)
    assert table.flags.writeable


def test_a_memory_mapped_table_is_adopted(tmp_path) -> None:
    np.save(tmp_path / "table.npy", CHAIN)
    table = np.load(tmp_path / "table.npy", mmap_mode="r")
    model = SafeMDP.deterministic(table, FAIL_LAST)
    assert np.shares_memory(model.next_state, table)


@pytest.mark.parametrize("dtype", [np.int8, np.int16, np.int64, np.uint8, np.uint64])
def test_other_integers_are_copied(dtype: type) -> None:
    table = CHAIN.astype(dtype)
    model = SafeMDP.deterministic(table, FAIL_LAST)
    assert model.next_state is not None
    assert model.next_state.dtype == np.int32
    assert np.array_equal(model.next_state, CHAIN)
    table[0, 0] = 1  # the input stays the caller's
    assert model.next_state[0, 0] == 0


def test_a_transposed_table_is_copied_in_row_order() -> None:
    model = SafeMDP.deterministic(np.asfortranarray(CHAIN), FAIL_LAST)
    assert model.next_state is not None
    assert model.next_state.flags.c_contiguous
    assert np.array_equal(model.next_state, CHAIN)


def test_masks_are_copied() -> None:
    fail = FAIL_LAST.copy()
    model = SafeMDP.deterministic(CHAIN.copy(), fail)
    fail[0] = True
    assert not model.fail[0]


def test_rows_of_fail_and_terminal_states_are_ignored() -> None:
    table = np.array([[0, 1], [-7, 99], [77, -1]])
    terminal = np.array([False, True, False])
    model = SafeMDP.deterministic(table, FAIL_LAST, terminal=terminal)
    assert model.available.tolist() == [[True, True], [True, True], [False, False]]
    assert model.successors().tolist() == [[0, 1], [1, 1], [-1, -1]]
    expected = np.zeros((6, 3))
    expected[0, 0] = expected[1, 1] = expected[2, 1] = expected[3, 1] = 1
    assert np.array_equal(model.transitions().toarray(), expected)


def test_stochastic_rows_of_fail_and_terminal_states_are_ignored() -> None:
    P = uniform_kernel(3, 2)
    P[1] = np.nan
    P[2] = -5
    terminal = np.array([False, True, False])
    kernel = SafeMDP.stochastic(P, FAIL_LAST, terminal=terminal).transitions().toarray()
    assert np.array_equal(kernel[2:4], [[0, 1, 0]] * 2)
    assert not kernel[4:].any()


def test_storage_forms_agree() -> None:
    P = np.zeros((3, 2, 3))
    for state in (0, 1):
        for action in (0, 1):
            P[state, action, CHAIN[state, action]] = 1
    deterministic = SafeMDP.deterministic(CHAIN.copy(), FAIL_LAST)
    dense = SafeMDP.stochastic(P, FAIL_LAST)
    assert np.array_equal(deterministic.transitions().toarray(), dense.transitions().toarray())
    assert np.array_equal(deterministic.available, dense.available)
    for form in (sparse.csr_array, sparse.csc_matrix, sparse.coo_array, sparse.lil_matrix):
        model = SafeMDP.stochastic(form(P.reshape(6, 3)), FAIL_LAST)
        assert np.array_equal(model.transitions().toarray(), dense.transitions().toarray())


def test_duplicate_sparse_entries_add_up_and_zeros_are_dropped() -> None:
    rows, columns = [0, 0, 0, 1], [1, 1, 0, 0]
    P = sparse.coo_array(([0.25, 0.75, 0.0, 1.0], (rows, columns)), shape=(2, 2))
    kernel = SafeMDP.stochastic(P, np.array([False, False])).transitions()
    assert kernel.nnz == 2
    assert np.array_equal(kernel.toarray(), [[0, 1], [1, 0]])


def test_unavailable_rows_are_ignored() -> None:
    P = uniform_kernel(2, 2)
    P[0, 1] = 0
    available = np.array([[True, False], [True, True]])
    model = SafeMDP.stochastic(P, np.array([False, True]), available)
    assert model.available.tolist() == [[True, False], [False, False]]
    P[0, 1] = 7
    again = SafeMDP.stochastic(P, np.array([False, True]), available)
    assert np.array_equal(again.transitions().toarray(), model.transitions().toarray())


def test_fractions_are_kept() -> None:
    third = Fraction(1, 3)
    P = np.array([[[third, 1 - third]], [[0, 1]]], dtype=object)
    model = SafeMDP.stochastic(P, np.array([False, False]))
    assert model.exact_probabilities() == (third, 1 - third, Fraction(1))


@pytest.mark.parametrize("number", [float, np.float64])
def test_floats_beside_fractions_are_read_as_decimals(number: type) -> None:
    P = np.array([[[number(0.1), Fraction(9, 10)]], [[0, 1]]], dtype=object)
    model = SafeMDP.stochastic(P, np.array([False, True]))
    assert model.exact == (Fraction(1, 10), Fraction(9, 10))


def test_no_fraction_is_rounded_to_zero() -> None:
    tiny = Fraction(1, 10**400)
    P = np.array([[[1 - tiny, tiny]], [[0, 0]]], dtype=object)
    model = SafeMDP.stochastic(P, np.array([False, True]))
    assert model.transitions().data.tolist() == [1.0, 5e-324]
    assert model.exact == (1 - tiny, tiny)
    assert value_iteration(model, 0.5).Q_upper[0, 0] > 0


def test_floats_are_read_as_their_shortest_decimal() -> None:
    P = np.array([[[0.1, 0.9]], [[0.0, 1.0]]])
    model = SafeMDP.stochastic(P, np.array([False, False]))
    assert model.exact_probabilities() == (Fraction(1, 10), Fraction(9, 10), Fraction(1))


def test_thirds_in_floats_are_no_exact_distribution() -> None:
    model = SafeMDP.stochastic(uniform_kernel(3, 1), FAIL_LAST)
    with pytest.raises(ValueError, match="state 0, action 0: probabilities sum to .*, not exactly"):
        model.exact_probabilities()


def test_initial_states_in_three_forms() -> None:
    def initial(value: object) -> np.ndarray:
        model = SafeMDP.deterministic(CHAIN.copy(), FAIL_LAST, initial=value)
        assert model.initial is not None
        return model.initial

    assert initial(1).tolist() == [0, 1, 0]
    assert initial([0, 1]).tolist() == [0.5, 0.5, 0]
    assert initial(np.array([True, False, False])).tolist() == [1, 0, 0]
    assert initial([0.25, 0.75, 0.0]).tolist() == [0.25, 0.75, 0]


def test_every_array_is_read_only() -> None:
    geometry = Geometry(cell=np.zeros((3, 2)))
    model = SafeMDP.stochastic(
        uniform_kernel(3, 2), FAIL_LAST, rewards=np.zeros((3, 2)), initial=[0], geometry=geometry
    )
    kernel = model.transitions()
    assert model.rewards is not None
    assert model.initial is not None
    arrays = [model.fail, model.terminal, model.available, model.rewards, model.initial]
    arrays += [kernel.data, kernel.indices, kernel.indptr, geometry.cell]
    assert not any(array.flags.writeable for array in arrays)


def test_names_appear_in_errors_and_sentences() -> None:
    model = SafeMDP.deterministic(
        CHAIN.copy(), FAIL_LAST, state_names=["a", "b", "c"], action_names=["stay", "go"]
    )
    assert model.state_name(1) == "state 1 (b)"
    assert model.action_name(0) == "action 0 (stay)"
    with pytest.raises(ValueError, match=re.escape("state 0 (a), action 1 (go): successor 3")):
        SafeMDP.deterministic(
            [[0, 3], [2, 2], [0, 0]],
            FAIL_LAST,
            state_names=["a", "b", "c"],
            action_names=["stay", "go"],
        )


def test_repr_counts() -> None:
    model = SafeMDP.deterministic(CHAIN.copy(), FAIL_LAST)
    assert repr(model) == "SafeMDP(deterministic, 3 states, 2 actions, 1 fail, 0 terminal)"


@pytest.mark.parametrize(
    ("next_state", "fail", "message"),
    [
        ([0, 1, 2], FAIL_LAST, "next_state must have shape (S, A)"),
        (np.zeros((3, 0), dtype=int), FAIL_LAST, "at least one action"),
        (np.zeros((0, 2), dtype=int), np.zeros(0, dtype=bool), "at least one state"),
        ([[0.0], [1.0], [2.0]], FAIL_LAST, "next_state must hold integers, not float64"),
        (CHAIN, [0, 0, 1], "fail must be a boolean mask, not int64"),
        (CHAIN, [True, False], "fail must have shape (3,), not (2,)"),
        ([[0, 3], [2, 2], [0, 0]], FAIL_LAST, "state 0, action 1: successor 3 is not a state"),
        ([[0, 1], [-2, 2], [0, 0]], FAIL_LAST, "state 1, action 0: successor -2 is not a state"),
        ([[0, 1], [-1, -1], [0, 0]], FAIL_LAST, "state 1 has no action"),
        ([[0, 1], [-1, -1], [0, 0]], FAIL_LAST, "mark it in `terminal`"),
        ([[2**40, 1], [2, 2], [0, 0]], FAIL_LAST, "successor 1099511627776 is not a state"),
    ],
)
def test_deterministic_refuses(next_state: object, fail: object, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        SafeMDP.deterministic(next_state, fail)


def test_a_state_cannot_be_fail_and_terminal() -> None:
    with pytest.raises(ValueError, match="state 2 is both fail and terminal"):
        SafeMDP.deterministic(CHAIN.copy(), FAIL_LAST, terminal=FAIL_LAST)


def changed(position: tuple[int, int, int], value: object) -> np.ndarray:
    P = uniform_kernel(3, 2)
    P[position] = value
    return P


@pytest.mark.parametrize(
    ("P", "message"),
    [
        (np.ones((3, 3)), "P must be dense with shape (S, A, S) or scipy.sparse"),
        (uniform_kernel(4, 2), "P must have shape (3, A, 3), not (4, 2, 4)"),
        (sparse.eye_array(4).tocsr(), "P must have shape (3*A, 3), not (4, 4)"),
        (uniform_kernel(3, 2) * 0.999, "state 0, action 0: probabilities sum to 0.999, not 1"),
        (changed((1, 1, 2), np.nan), "state 1, action 1: probability nan"),
        (changed((1, 1, 2), np.inf), "state 1, action 1: probability inf"),
        (changed((0, 1, 2), -0.5), "state 0, action 1: negative probability -0.5"),
        (np.zeros((3, 2, 3)), "mark the action in `available` if it cannot be taken"),
        (changed((0, 0, 0), 1 / 3 + 2e-9), "state 0, action 0: probabilities sum to"),
    ],
)
def test_stochastic_refuses(P: object, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        SafeMDP.stochastic(P, FAIL_LAST)


@pytest.mark.parametrize("kind", [complex, str, "datetime64[s]"])
def test_numbers_that_are_not_real_are_refused(kind: type | str) -> None:
    P = np.ones((1, 1, 1), dtype=np.int64).astype(kind)
    with pytest.raises(ValueError, match=r"^P must hold real numbers \(or, if dense, Fractions\)"):
        SafeMDP.stochastic(P, np.array([False]))
    with pytest.raises(ValueError, match="not complex128"):
        SafeMDP.stochastic(sparse.csr_array([[1j]]), np.array([False]))


def test_rows_may_miss_one_by_rounding() -> None:
    SafeMDP.stochastic(changed((0, 0, 0), 1 / 3 + 5e-10), FAIL_LAST)


def test_fractions_must_sum_to_exactly_one() -> None:
    P = np.array([[[Fraction(1, 2), Fraction(1, 2) - Fraction(1, 10**12)]]] * 2, dtype=object)
    with pytest.raises(
        ValueError, match="state 0, action 0: probabilities sum to .*, not exactly 1"
    ):
        SafeMDP.stochastic(P, np.array([False, False]))
    P = np.array([[["one", Fraction(1, 2)]]] * 2, dtype=object)
    with pytest.raises(ValueError, match="'one' is not a probability"):
        SafeMDP.stochastic(P, np.array([False, False]))
    P = np.array([[[Fraction(3, 2), Fraction(-1, 2)]]] * 2, dtype=object)
    with pytest.raises(ValueError, match="negative probability -1/2"):
        SafeMDP.stochastic(P, np.array([False, False]))


def test_sparse_indices_out_of_range_are_found() -> None:
    P = sparse.csr_array((np.ones(2), np.array([0, 1]), np.array([0, 1, 2])), shape=(2, 2))
    P.indices[1] = 5
    with pytest.raises(ValueError, match="state 1, action 0: successor 5 is not a state"):
        SafeMDP.stochastic(P, np.array([False, False]))


def test_available_is_checked() -> None:
    P, fail = uniform_kernel(2, 2), np.array([False, True])
    with pytest.raises(ValueError, match="available must be a boolean mask"):
        SafeMDP.stochastic(P, fail, np.ones((2, 2)))
    with pytest.raises(ValueError, match="state 0 has no action"):
        SafeMDP.stochastic(P, fail, np.zeros((2, 2), dtype=bool))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rewards": np.zeros((2, 2))}, "rewards must have shape (3, 2), not (2, 2)"),
        ({"rewards": np.full((3, 2), np.nan)}, "state 0, action 0: reward nan is not finite"),
        ({"initial": [3]}, "initial: states must lie in 0 to 2"),
        ({"initial": np.zeros(3, dtype=bool)}, "initial: at least one state is needed"),
        ({"initial": [0.5, 0.4, 0.0]}, "initial: probabilities sum to 0.9, not 1"),
        ({"initial": [-0.5, 1.5, 0.0]}, "initial: state 0 has probability -0.5"),
        ({"initial": [0.5, 0.5]}, "initial must have shape (3,), not (2,)"),
        ({"state_names": ["a"]}, "state_names: expected 3 names, got 1"),
        ({"action_names": ["a"]}, "action_names: expected 2 names, got 1"),
        ({"geometry": Geometry(cell=np.zeros((2, 2)))}, "geometry: expected 3 cells, got 2"),
        (
            {"geometry": Geometry(cell=np.zeros((3, 2)), arrows=((0, 1),))},
            "geometry: expected 2 arrows, got 1",
        ),
        ({"terminal": [0, 1, 0]}, "terminal must be a boolean mask"),
    ],
)
def test_options_are_checked(options: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        SafeMDP.deterministic(CHAIN.copy(), FAIL_LAST, **options)


def test_geometry_needs_two_columns() -> None:
    with pytest.raises(ValueError, match="cell must have shape"):
        Geometry(cell=np.zeros(3))


def test_successors_are_for_tables_only() -> None:
    with pytest.raises(ValueError, match="the model is stochastic"):
        SafeMDP.stochastic(uniform_kernel(3, 1), FAIL_LAST).successors()


SIX_DIGITS = [0.25, 0.333333, 0.416666]


def one_row(row: object, **options: object) -> SafeMDP:
    """State 0 has this row, 1 and 2 stay and 2 fails."""
    P = np.zeros((3, 1, 3), dtype=getattr(row, "dtype", object))
    P[0, 0], P[1, 0, 1] = row, P.dtype.type(1) if P.dtype != object else 1
    return SafeMDP.stochastic(P, FAIL_LAST, **options)


class TestRowsThatMissOne:
    """By six digits or single precision: mended only where that is asked for, and counted."""

    @pytest.mark.parametrize(
        "row",
        [
            np.array(SIX_DIGITS),
            np.array([1 / 3] * 3, dtype=np.float32),
            np.array([0.1, 0.9, 0], dtype=np.float32),
            [Fraction(str(p)) for p in SIX_DIGITS],
            SIX_DIGITS,
        ],
        ids=["six digits", "thirds", "tenths", "fractions", "objects"],
    )
    def test_refused_by_name_or_mended(self, row: object) -> None:
        with pytest.raises(
            ValueError,
            match=r"^state 0, action 0: probabilities sum to \S+, not (exactly )?1; "
            r"normalise=True \(--normalise\) divides such probabilities by their sum$",
        ):
            one_row(row)
        model = one_row(row, normalise=True)
        given = [Fraction(p) if isinstance(p, Fraction) else Fraction(repr(float(p))) for p in row]
        quotients = [p / sum(given) for p in given if p]
        assert model.transitions().data[:-1] == pytest.approx(
            list(map(float, quotients)), rel=4e-16
        )
        if isinstance(row, list):
            assert model.exact == (*quotients, Fraction(1))
        assert sum(model.exact_probabilities()[:-1]) == 1
        assert model.normalised == 1
        assert repr(model).endswith("1 fail, 0 terminal, 1 rows normalised)")

    def test_thirds_of_six_digits_are_exact_thirds(self) -> None:
        model = one_row(np.array([0.333333] * 3), normalise=True)
        assert model.exact_probabilities()[:3] == (Fraction(1, 3),) * 3

    @pytest.mark.parametrize("off", [1.1e-6, -1.1e-6, 0.5, -0.5, np.nan])
    @pytest.mark.parametrize("number", [float, Fraction])
    def test_what_misses_one_by_more_is_a_mistake(self, off: float, number: type) -> None:
        if number is Fraction and np.isnan(off):
            return
        row = np.array([number(0.5), number(0.5 + off), number(0)])
        for options in ({}, {"normalise": True}):
            with pytest.raises(ValueError, match="^state 0, action 0: probabilit") as caught:
                one_row(row, **options)
            assert "--normalise" not in str(caught.value)

    @pytest.mark.parametrize("off", [0.9e-6, -0.9e-6])
    def test_as_far_as_promised(self, off: float) -> None:
        assert one_row(np.array([0.5, 0.5 + off, 0]), normalise=True).normalised == 1

    def test_rows_that_are_right_stay_to_the_bit(self) -> None:
        row = np.array([0.1, 0.2, 0.7 + 5e-10])
        model = one_row(row, normalise=True)
        assert model.transitions().data[:3].tolist() == row.tolist()
        assert model.normalised == 0
        assert "normalised" not in repr(model)
        assert one_row(row).normalised is None

    def test_the_initial_distribution(self) -> None:
        initial = np.array([1 / 3] * 3, dtype=np.float32)
        with pytest.raises(ValueError, match="^initial: probabilities sum to .*--normalise"):
            SafeMDP.deterministic(CHAIN.copy(), FAIL_LAST, initial=initial)
        model = SafeMDP.deterministic(CHAIN.copy(), FAIL_LAST, initial=initial, normalise=True)
        assert model.initial == pytest.approx([1 / 3] * 3, rel=4e-16)
        assert model.normalised == 1
        both = one_row(np.array(SIX_DIGITS), initial=initial, normalise=True)
        assert both.normalised == 2

    def test_six_digits_of_many_entries_miss_by_more(self) -> None:
        P = np.zeros((7, 1, 7))
        P[0, 0, :6] = 0.166667
        fail = np.arange(7) > 0
        model = SafeMDP.stochastic(P, fail, normalise=True)
        assert model.exact_probabilities() == (Fraction(1, 6),) * 6
        P[0, 0, 6] = 2e-6
        with pytest.raises(ValueError, match="sum to 1.000004, not 1$"):
            SafeMDP.stochastic(P, fail, normalise=True)


class TestMaskedArrays:
    """A masked action is one that is not there; anything else that is masked is refused."""

    def test_a_masked_successor(self) -> None:
        for kind in (np.int32, np.int64, np.uint64):
            table = np.ma.array(CHAIN.astype(kind), mask=[[0, 1], [0, 0], [1, 1]])
            model = SafeMDP.deterministic(table, FAIL_LAST)
            assert model.successors().tolist() == [[0, -1], [2, 2], [-1, -1]]
            rows = SafeMDP.deterministic(list(table), FAIL_LAST)
            assert rows.available.tolist() == model.available.tolist()
        assert SafeMDP.deterministic(np.ma.array(CHAIN), FAIL_LAST).available[0].all()
        with pytest.raises(ValueError, match="state 0 has no action"):
            SafeMDP.deterministic(np.ma.array(CHAIN, mask=[[1, 1], [0, 0], [0, 0]]), FAIL_LAST)

    @pytest.mark.parametrize("dtype", [np.float64, object])
    def test_a_masked_row(self, dtype: type) -> None:
        P = np.zeros((3, 2, 3), dtype=dtype)
        P[:2, :, 1] = dtype(1) if dtype is not object else Fraction(1)
        mask = np.zeros(P.shape, dtype=bool)
        mask[0, 1], mask[2, 0, 1] = True, True  # in part in a fail state, where nothing counts
        model = SafeMDP.stochastic(np.ma.array(P, mask=mask), FAIL_LAST)
        assert model.available.tolist() == [[True, False], [True, True], [False, False]]
        with pytest.raises(ValueError, match="^state 0, action 1: .* masked .*, but is available$"):
            SafeMDP.stochastic(np.ma.array(P, mask=mask), FAIL_LAST, np.ones((3, 2), dtype=bool))
        mask[1, 0, 0] = True
        with pytest.raises(ValueError, match="^state 1, action 0: .* is not masked as a whole$"):
            SafeMDP.stochastic(np.ma.array(P, mask=mask), FAIL_LAST)
        again = SafeMDP.stochastic(
            np.ma.array(P, mask=mask), FAIL_LAST, np.array([[1, 0], [0, 1], [0, 0]]) == 1
        )
        assert again.available.tolist() == [[True, False], [False, True], [False, False]]

    @pytest.mark.parametrize("name", ["terminal", "rewards", "initial", "fail", "available"])
    def test_nothing_else_can_be_missing(self, name: str) -> None:
        whole: dict[str, np.ndarray] = {
            "fail": FAIL_LAST,
            "terminal": np.zeros(3, dtype=bool),
            "rewards": np.zeros((3, 2)),
            "initial": np.array([1.0, 0.0, 0.0]),
            "available": np.ones((3, 2), dtype=bool),
        }
        whole[name] = np.ma.array(
            whole[name], mask=np.arange(whole[name].size).reshape(whole[name].shape) == 1
        )
        place = "0, 1" if whole[name].ndim == 2 else "1"
        with pytest.raises(ValueError, match=rf"^{name}\[{place}\] is masked, and must be known$"):
            SafeMDP.stochastic(uniform_kernel(3, 2), **whole)
        if name != "available":
            del whole["available"]
            with pytest.raises(ValueError, match=rf"^{name}\[{place}\] is masked"):
                SafeMDP.deterministic(CHAIN.copy(), **whole)


HUGE = 10**400


@pytest.mark.parametrize(
    ("P", "message"),
    [
        (uniform_kernel(3, 2).transpose(1, 0, 2), "if it is (A, S, S), pass P.transpose(1, 0, 2)"),
        (uniform_kernel(3, 2).transpose(0, 2, 1), "if it is (S, S, A), pass P.transpose(0, 2, 1)"),
        ([sparse.eye_array(3).tocsr()] * 2, "P is a list of sparse matrices"),
        ([[[1.0, 0.0, 0.0], [1.0]]], "P is not an array: "),
        (None, "P must be dense with shape (S, A, S) or scipy.sparse"),
        (np.zeros((3, 2, 3), dtype=[("p", float)]), "not [('p', '<f8')]"),
        (uniform_kernel(3, 2).astype(complex), "not complex128"),
        (uniform_kernel(3, 2).astype(np.float16), "state 0, action 0: probabilities sum to 0.9997"),
        (np.full((3, 2, 3), 2**62), "state 0, action 0: probabilities sum to 1.3835"),
        (np.full((3, 2, 3), HUGE, dtype=object), "probabilities sum to about 2**1330, not exactly"),
        (np.full((3, 2, 3), 1 << 10**7, dtype=object), "a probability with more than 10,000 bits"),
        (np.full((3, 2, 3), Fraction(1, 1 << 10**7), dtype=object), "more than 10,000 bits"),
        (np.full((3, 2, 3), Fraction(-HUGE), dtype=object), "negative probability about -2**13"),
        (np.full((3, 2, 3), Decimal("1e999999999"), dtype=object), "is not a probability"),
        (np.full((3, 2, 3), "1e-999999999", dtype=object), "is not a probability"),
        (np.full((3, 2, 3), Decimal("Infinity"), dtype=object), "'Infinity' is not a probability"),
        (np.full((3, 2, 3), np.nan, dtype=object), "'nan' is not a probability"),
        (np.full((3, 2, 3), 1j, dtype=object), "'1j' is not a probability"),
        (np.full((3, 2, 3), None), "'None' is not a probability"),
    ],
)
def test_odd_kernels_are_refused_soon(P: object, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)) as caught:
        SafeMDP.stochastic(P, FAIL_LAST)
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize("odd", [np.arange(2), Decimal("sNaN")])
def test_no_numbers_among_fractions(odd: object) -> None:
    P = np.full((3, 1, 3), Fraction(1, 3), dtype=object)
    P[0, 0, 0] = odd
    with pytest.raises(ValueError, match="P holds objects that are no numbers"):
        SafeMDP.stochastic(P, FAIL_LAST)


def test_odd_numbers_that_are_read_right() -> None:
    """As text, as decimals, as NumPy's integers, whose products would overflow."""
    for third in ("1/3", Fraction(np.int64(1), np.int64(3))):
        P = np.array([[[third, "2/3"]], [[np.int64(0), True]]], dtype=object)
        model = SafeMDP.stochastic(P, np.array([False, False]))
        assert model.exact == (Fraction(1, 3), Fraction(2, 3), Fraction(1))
        assert all(type(p.numerator) is int for p in model.exact)
    P = np.array([[[np.float32(0.5), Decimal("0.5")]]] * 2, dtype=object)
    P[:, 0, 0], P[:, 0, 1] = Decimal("0.1"), np.float64(0.9)
    assert SafeMDP.stochastic(P, np.array([False, True])).exact == (
        Fraction(1, 10),
        Fraction(9, 10),
    )


@pytest.mark.parametrize("number", [float, Fraction])
def test_a_negative_zero_is_a_zero(number: type) -> None:
    P = np.array([[[-0.0, number(1)]], [[-0.0, number(1)]]])
    model = SafeMDP.stochastic(P, np.array([False, False]), initial=[-0.0, 1.0])
    assert model.transitions().nnz == 2
    assert model.initial is not None
    assert not np.signbit(model.initial).any()


@pytest.mark.parametrize(
    ("next_state", "message"),
    [
        (
            CHAIN.T,
            "not (3,); if next_state is (A, S), pass next_state.T",
        ),
        (CHAIN.astype("m8[s]"), "next_state must hold integers, not timedelta64[s]"),
        (CHAIN.astype(object), "next_state must hold integers, not object"),
        ([[2**70, 1], [2, 2], [0, 0]], "next_state must hold integers, not object"),
        (np.full((3, 2), 2**64 - 1, dtype=np.uint64), "successor 18446744073709551615 is not"),
        (
            np.ma.array(np.full((3, 2), 2**64 - 1, dtype=np.uint64), mask=np.eye(3, 2)),
            "successor 2147483647 is",
        ),
        ([[0, 1], [2]], "next_state is not an array: "),
        (CHAIN > 0, "next_state must hold integers, not bool"),
    ],
)
def test_odd_tables_are_refused(next_state: object, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        SafeMDP.deterministic(next_state, FAIL_LAST)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rewards": np.full((3, 2), 1j)}, "rewards must hold real numbers, not complex128"),
        ({"rewards": CHAIN.astype("M8[s]")}, "rewards must hold real numbers, not datetime64[s]"),
        (
            {"rewards": np.full((3, 2), HUGE, dtype=object)},
            "rewards must hold real numbers: int too",
        ),
        (
            {"initial": np.array([1, 0, 0], "m8[s]")},
            "initial must hold real numbers, not time",
        ),
        ({"initial": np.array([1j, 0, 0])}, "initial must hold real numbers, not complex128"),
        ({"initial": [HUGE, 0, 0]}, "initial must hold real numbers: int too large"),
        ({"initial": [np.inf, 0, 0]}, "initial: probabilities sum to inf, not 1"),
        ({"initial": [np.nan, 1, 0]}, "initial: state 0 has probability nan"),
    ],
)
def test_odd_options_are_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        SafeMDP.deterministic(CHAIN.copy(), FAIL_LAST, **options)


def test_large_exact_models_need_no_dense_array() -> None:
    """Dense, this one would fill 3 GB."""
    n = 20_000
    entries = ExactEntries(
        row=np.repeat(np.arange(n), 3),
        column=np.column_stack([np.arange(n), np.zeros(n, int), np.zeros(n, int)]).ravel(),
        value=np.array([Fraction(1, 3)] * (3 * n), dtype=object),
        shape=(n, n),
    )
    model = SafeMDP.stochastic(entries, np.arange(n) == n - 1)
    assert model.exact is not None
    assert model.exact[:3] == (Fraction(1), Fraction(2, 3), Fraction(1, 3))
    assert model.transitions().indices[:3].tolist() == [0, 0, 1]
