"""Conditions as text: what they mean, and that nothing else gets through."""

import numpy as np
import pytest

from dead_ends.io.condition import evaluate_condition, names_in

COLUMNS = {
    "s": np.array([0, 1, 2, 3]),
    "a": np.array([1, 0, 1, 0]),
    "r": np.array([-100.0, -1.0, 0.0, 2.5]),
    "s2": np.array([3, 2, 1, 0]),
    "done": np.array([False, False, True, True]),
}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("r <= -100", [True, False, False, False]),
        ("r <= -1 and not done", [True, True, False, False]),
        ("done or s == 0", [True, False, True, True]),
        ("done", [False, False, True, True]),
        ("not done", [True, True, False, False]),
        ("s2 in (0, 3)", [True, False, False, True]),
        ("s2 not in [0, 3]", [False, True, True, False]),
        ("s2 in {1}", [False, False, True, False]),
        ("s2 in []", [False, False, False, False]),
        ("0 < s <= 2", [False, True, True, False]),
        ("s + s2 == 3 and -r > 0", [True, True, False, False]),
        ("s * 2 - 1 == 3", [False, False, True, False]),
        ("s // 2 == 1 and s % 2 == 0", [False, False, True, False]),
        ("s / 2 == 1.5", [False, False, False, True]),
        ("a != 1", [False, True, False, True]),
        ("done == True", [False, False, True, True]),
        ("True", [True, True, True, True]),
        ("1 > 2", [False, False, False, False]),
    ],
)
def test_meaning(text: str, expected: list[bool]) -> None:
    value = evaluate_condition(text, COLUMNS)
    assert value.dtype == np.bool_
    assert value.tolist() == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("r <=", "not an expression"),
        ("", "not an expression"),
        ("r = 1", "not an expression"),
        ("x > 1", r"unknown name 'x' \(known here: s, a, r, s2, done\)"),
        ("r", "gives a number, not true or false"),
        ("r > 1 and s", "'s' is not true or false"),
        ("not s", "'s' is not true or false"),
        ("done + 1 > 0", "'done' is not a number"),
        ("-done > 0", "'done' is not a number"),
        ("s / 0 > 1", "division by zero"),
        ("1 // 0 > 1", "division by zero"),
        ("s % (s - 1) > 1", "division by zero"),
        ("s is 1", "'is' is not allowed"),
        ("s in 3", "'3' is not a list"),
        ("s in (a, 3)", "not a list of numbers"),
        ("2 ** 9999999 > r", "is not allowed"),
        ("__import__('os').system('true') == 0", "is not allowed"),
        ("(lambda: True)()", "is not allowed"),
        ("s.real > 0", "is not allowed"),
        ("s[0] > 0", "is not allowed"),
        ("'a' == 'a'", "is not allowed"),
        ("(x := 1) == 1", "is not allowed"),
        ("\0", "not an expression"),
        (f"{10**400} > s / 1.5", "too large"),
        ("s * 4611686018427387904 * 4 == 0", "numbers are too large"),
        ("s - 9223372036854775807 - 9 > 0", "numbers are too large"),
        ("r * 1e308 < 0", "numbers are too large"),
    ],
)
def test_everything_else_is_refused(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        evaluate_condition(text, COLUMNS)


def test_a_condition_can_only_use_what_is_there() -> None:
    with pytest.raises(ValueError, match=r"unknown name 'r' \(known here: s\)"):
        evaluate_condition("r > 0", {"s": np.arange(3)})


def test_a_qualified_name_is_one_name() -> None:
    columns = {"model.s": np.array([1, 2])}
    assert evaluate_condition("model.s > 1", columns).tolist() == [False, True]
    with pytest.raises(ValueError, match=r"'model.t' is not allowed"):
        evaluate_condition("model.t > 1", columns)


def test_names_in_a_condition() -> None:
    assert names_in("x == 2 and (model.s > x or -b in [1, y])") == ["b", "model.s", "x", "y"]
    assert names_in("model > 1 and model.s > 1") == ["model", "model.s"]
    assert names_in("1 > 2") == []
