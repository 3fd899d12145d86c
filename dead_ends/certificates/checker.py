"""An independent check that a labelling is right, from its certificate.

The checker shares no code with the solver: it does not search, it only compares each state
with its successors, once. What it accepts is right because of these conditions (labels FAIL 0,
DEAD 1, SAFE 2, AT_RISK 3; a successor is a state reached with positive probability):

* FAIL: exactly the model's fail states.
* DEAD: every successor of every action is dead or fail. So every path stays there until it
  fails, and by the ranks below it does: surely in deterministic models, with probability 1 in
  stochastic ones.
* DEAD or AT_RISK: ``rank`` is positive and each available action has a successor of strictly
  lower rank that is not safe (fail has rank 0). So fail is reached with positive probability
  whatever the agent does. In deterministic models the rank must be 1 + the greatest rank of the
  successors, so that it is the survival time.
* SAFE: ``action`` is available and all its successors are safe. So repeating it never fails.
* AT_RISK (stochastic models only): ``escape`` is positive and ``action`` has a successor that
  is at risk or safe, of strictly lower escape (safe states have escape 0). So some policy
  reaches the safe states with positive probability.

Every other entry is fixed: rank and escape 0, action -1. Together the conditions decide each
label, P_min(F fail) = 1, = 0 or between; Definition 2 of the paper in deterministic models.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dead_ends.model.digest import model_digest
from dead_ends.model.safe_mdp import SafeMDP, require_type

__all__ = ["Certificate", "CertificateError", "check_certificate"]

FAIL, DEAD, SAFE, AT_RISK = range(4)
NEVER = np.iinfo(np.int64).max
BLOCK = 1 << 18
"""States compared at a time: what the checker holds beside the columns stays small."""


class CertificateError(ValueError):
    """The certificate does not prove the labels of this model."""


@dataclass(frozen=True, eq=False)
class Certificate:
    """Labels and the witnesses that prove them; see the module's text.

    Attributes:
        digest: of the model, see :func:`dead_ends.model.digest.model_digest`.
        labels: integers (S,).
        rank, escape, action: integers (S,).
    """

    digest: str
    labels: NDArray[np.integer[Any]]
    rank: NDArray[np.integer[Any]]
    escape: NDArray[np.integer[Any]]
    action: NDArray[np.integer[Any]]


def check_certificate(model: SafeMDP, certificate: Certificate) -> None:
    """Accept the certificate silently, in time linear in the model's transitions.

    Raises:
        CertificateError: naming the first state whose condition does not hold.
    """
    require_type(model, SafeMDP, "check_certificate")
    require_type(certificate, Certificate, "check_certificate")
    for name in ("labels", "rank", "escape", "action"):
        array = getattr(certificate, name)
        if array.shape != (model.num_states,) or array.dtype.kind not in "iu":
            raise CertificateError(f"{name}: {model.num_states} integers are needed, one a state")
    if model.estimate:
        raise CertificateError("the model is an estimate from a log, so its labels prove nothing")
    if certificate.digest != model_digest(model):
        raise CertificateError("the certificate is of another model")
    labels, rank, escape, action = (
        getattr(certificate, name).astype(np.int64)
        for name in ("labels", "rank", "escape", "action")
    )
    unsafe, chooses = (labels == DEAD) | (labels == AT_RISK), labels >= SAFE

    def require(condition: NDArray[np.bool_], what: str, first: int = 0) -> None:
        if not condition.all():
            raise CertificateError(f"{model.state_name(first + int(condition.argmin()))}: {what}")

    require((labels >= FAIL) & (labels <= AT_RISK), "not a label")
    require((labels == FAIL) == model.fail, "the label fail belongs to the fail states alone")
    require((labels != AT_RISK) | (not model.is_deterministic), "at risk in a deterministic model")
    require((rank > 0) == unsafe, "rank must be positive if dead or at risk, else 0")
    require((rank >= 0) & (escape >= 0), "rank and escape must not be negative")
    require((escape > 0) == (labels == AT_RISK), "escape must be positive if at risk, else 0")
    require((action >= -1) & (action < model.num_actions), "not an action")
    require((action >= 0) == chooses, "safe and at-risk states have an action, others -1")

    for start in range(0, model.num_states, BLOCK):
        # The transitions of a block of states, as columns: their choice, source s and target.
        ends, target = _transitions(model, start)
        choice = np.repeat(np.arange(len(ends) - 1) + start * model.num_actions, np.diff(ends))
        source = choice // model.num_actions
        first = ends[:-1][np.diff(ends) > 0]  # each available choice's first place
        owner = source[first]
        states = np.arange(start, min(start + BLOCK, model.num_states))
        chosen = choice == source * model.num_actions + action[source]
        found = _any(chosen, source, states)
        require(~chooses[states] | found, "its action is not available", start)

        stays = (labels[source] != DEAD) | (labels[target] <= DEAD)
        require(_all(stays, source, states), "labelled dead, with a successor that is not", start)
        stays = ~(chosen & (labels[source] == SAFE)) | (labels[target] == SAFE)
        stays = _all(stays, source, states)
        require(stays, "labelled safe, and its action may leave the safe states", start)

        danger = np.where(labels[target] == SAFE, NEVER, rank[target])
        nearest = np.minimum.reduceat(danger, first) if len(first) else danger
        lower = _all(~unsafe[owner] | (nearest < rank[owner]), owner, states)
        require(lower, "some action has no unsafe successor of lower rank", start)
        if model.is_deterministic:
            tight = ~unsafe[states] | _any(nearest == rank[owner] - 1, owner, states)
            require(tight, "rank is not 1 + the greatest of successors", start)
        nearer = chosen & (labels[target] >= SAFE) & (escape[target] < escape[source])
        nearer = (labels[states] != AT_RISK) | _any(nearer, source, states)
        require(nearer, "its action does not escape", start)


def _successors(model: SafeMDP, start: int) -> NDArray[np.int32]:
    """int32 (BLOCK, A) of a deterministic model: fail states have none, terminal ones stay."""
    assert model.next_state is not None
    block = slice(start, start + BLOCK)
    table = np.array(model.next_state[block])
    table[model.fail[block]] = -1
    terminal = np.flatnonzero(model.terminal[block])
    table[terminal] = terminal[:, None] + start
    return table


def _transitions(model: SafeMDP, start: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """The targets of a block of states, and where those of each choice s*A + a end."""
    if model.is_deterministic:
        flat = _successors(model, start).ravel()
        return np.concatenate(([0], np.cumsum(flat >= 0))), flat[flat >= 0]
    kernel = model.transitions()
    ends = kernel.indptr[start * model.num_actions : (start + BLOCK) * model.num_actions + 1]
    return ends - ends[0], kernel.indices[ends[0] : ends[-1]]


def _any(
    holds: NDArray[np.bool_], owner: NDArray[np.int64], states: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """For each of the consecutive states: whether it owns an entry that holds."""
    result = np.zeros(len(states), dtype=np.bool_)
    result[owner[holds] - states[0]] = True
    return result


def _all(
    holds: NDArray[np.bool_], owner: NDArray[np.int64], states: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """For each of the consecutive states: whether every entry that it owns holds."""
    return ~_any(~holds, owner, states)
