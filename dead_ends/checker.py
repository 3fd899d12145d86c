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

import hashlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dead_ends.model import SafeMDP

__all__ = ["Certificate", "CertificateError", "check_certificate", "model_digest"]

FAIL, DEAD, SAFE, AT_RISK = range(4)
NEVER = np.iinfo(np.int64).max


class CertificateError(ValueError):
    """The certificate does not prove the labels of this model."""


@dataclass(frozen=True, eq=False)
class Certificate:
    """Labels and the witnesses that prove them; see the module's text.

    Attributes:
        digest: of the model, see :func:`model_digest`.
        labels: integers (S,).
        rank, escape, action: integers (S,).
    """

    digest: str
    labels: NDArray[np.integer[Any]]
    rank: NDArray[np.integer[Any]]
    escape: NDArray[np.integer[Any]]
    action: NDArray[np.integer[Any]]


def model_digest(model: SafeMDP) -> str:
    """SHA-256 of the transitions and the ends; names and rewards do not count."""
    kind = "deterministic" if model.is_deterministic else "stochastic"
    content = hashlib.sha256(f"{kind} {model.num_states} {model.num_actions}\n".encode())
    content.update(np.packbits(model.fail).tobytes() + np.packbits(model.terminal).tobytes())
    if model.is_deterministic:
        content.update(model.successors().astype("<i4").tobytes())
    else:
        kernel = model.transitions()
        content.update(kernel.indptr.astype("<i8").tobytes())
        content.update(kernel.indices.astype("<i4").tobytes())
        content.update(kernel.data.astype("<f8").tobytes())
        content.update(" ".join(map(str, model.exact or ())).encode())
    return content.hexdigest()


def check_certificate(model: SafeMDP, certificate: Certificate) -> None:
    """Accept the certificate silently, in time linear in the model's transitions.

    Raises:
        CertificateError: naming the first state whose condition does not hold.
    """
    for name in ("labels", "rank", "escape", "action"):
        array = getattr(certificate, name)
        if array.shape != (model.num_states,) or array.dtype.kind not in "iu":
            raise CertificateError(f"{name}: {model.num_states} integers are needed, one a state")
    if certificate.digest != model_digest(model):
        raise CertificateError("the certificate is of another model")
    labels, rank, escape, action = (
        getattr(certificate, name).astype(np.int64)
        for name in ("labels", "rank", "escape", "action")
    )
    unsafe, chooses = (labels == DEAD) | (labels == AT_RISK), labels >= SAFE

    def require(condition: NDArray[np.bool_], what: str) -> None:
        if not condition.all():
            raise CertificateError(f"{model.state_name(int(condition.argmin()))}: {what}")

    require((labels >= FAIL) & (labels <= AT_RISK), "not a label")
    require((labels == FAIL) == model.fail, "the label fail belongs to the fail states alone")
    require((labels != AT_RISK) | (not model.is_deterministic), "at risk in a deterministic model")
    require((rank > 0) == unsafe, "rank must be positive if dead or at risk, else 0")
    require((rank >= 0) & (escape >= 0), "rank and escape must not be negative")
    require((escape > 0) == (labels == AT_RISK), "escape must be positive if at risk, else 0")
    require((action >= -1) & (action < model.num_actions), "not an action")
    require((action >= 0) == chooses, "safe and at-risk states have an action, others -1")

    # The transitions, as columns: the choice s*A + a of each, its source s and its target.
    kernel = model.transitions()
    choice = np.repeat(np.arange(len(kernel.indptr) - 1), np.diff(kernel.indptr))
    source, target = choice // model.num_actions, kernel.indices
    first = kernel.indptr[:-1][np.diff(kernel.indptr) > 0]  # each available choice's first place
    owner = source[first]
    chosen = choice == source * model.num_actions + action[source]
    require(~chooses | _any(chosen, source, labels), "its action is not available")

    stays = ~(labels[source] == DEAD) | (labels[target] <= DEAD)
    require(_all(stays, source, labels), "labelled dead, with a successor that is not")
    stays = ~(chosen & (labels[source] == SAFE)) | (labels[target] == SAFE)
    require(_all(stays, source, labels), "labelled safe, and its action may leave the safe states")

    danger = np.where(labels[target] == SAFE, NEVER, rank[target])
    nearest = np.minimum.reduceat(danger, first) if len(first) else danger
    lower = ~unsafe[owner] | (nearest < rank[owner])
    require(_all(lower, owner, labels), "some action has no unsafe successor of lower rank")
    if model.is_deterministic:
        tight = unsafe[owner] & (nearest == rank[owner] - 1)
        require(~unsafe | _any(tight, owner, labels), "rank is not 1 + the greatest of successors")
    nearer = chosen & (labels[target] >= SAFE) & (escape[target] < escape[source])
    require((labels != AT_RISK) | _any(nearer, source, labels), "its action does not escape")


def _any(
    holds: NDArray[np.bool_], owner: NDArray[np.int64], states: NDArray[Any]
) -> NDArray[np.bool_]:
    """For each state: whether it owns an entry that holds."""
    result = np.zeros(len(states), dtype=np.bool_)
    result[owner[holds]] = True
    return result


def _all(
    holds: NDArray[np.bool_], owner: NDArray[np.int64], states: NDArray[Any]
) -> NDArray[np.bool_]:
    """For each state: whether every entry that it owns holds."""
    return ~_any(~holds, owner, states)
