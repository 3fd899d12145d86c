"""The same models in Storm (stormpy) and in QuantEcon's DiscreteDP.

Storm is given a model as a UMB file (a tar of flat binary arrays, which numpy writes), the
fastest way in from arrays. Its labels are ``compute_prob01_states`` for P_min, its survival
times the greatest expected number of steps before fail, infinite where fail can be avoided.

QuantEcon gets state-action pairs with a sparse matrix and solves for the discounted cost by
value iteration: V = beta**(T - 1) on dead states, and 0 on safe ones.
"""

from __future__ import annotations

import io
import json
import tarfile
from pathlib import Path
from typing import Any

import numpy as np
import quantecon
import stormpy
import stormpy.analysis
import stormpy.io
from numpy.typing import NDArray
from scipy import sparse

STEPS = 'R{"steps"}max=? [F "fail"]'
FAIL = 'Pmin=? [F "fail"]'


def write_umb(path: Path, kernel: sparse.csr_array, num_actions: int, fail: NDArray[Any]) -> None:
    """A UMB file of an MDP whose kernel has a row for each available action; fail stays put."""
    num_states = len(fail)
    sizes = np.diff(kernel.indptr)
    choices = np.add.reduceat(sizes > 0, np.arange(0, len(sizes), num_actions), dtype=np.uint64)
    arrays = {
        "state-is-initial.bin": _bits(np.arange(num_states) == 0),
        "state-to-choices.bin": _offsets(choices),
        "choice-to-branches.bin": _offsets(sizes[sizes > 0]),
        "branch-to-target.bin": kernel.indices.astype(np.uint64),
        "branch-to-probability.bin": kernel.data,
        "annotations/aps/fail/states/values.bin": _bits(fail),
        "annotations/rewards/steps/states/values.bin": np.where(fail, 0.0, 1.0),
    }
    boolean, double = {"size": 1, "type": "bool"}, {"size": 64, "type": "double"}
    index = {
        "annotations": {
            "aps": {"fail": {"alias": "fail", "applies-to": ["states"], "type": boolean}},
            "rewards": {
                "steps": {"alias": "steps", "applies-to": ["states"], "lower": 0, "type": double}
            },
        },
        "format-revision": 0,
        "format-version": 1,
        "transition-system": {
            "#branch-actions": 0,
            "#branches": int(kernel.nnz),
            "#choice-actions": 0,
            "#choices": int((sizes > 0).sum()),
            "#initial-states": 1,
            "#observations": 0,
            "#players": 1,
            "#states": num_states,
            "branch-probability-type": double,
            "time": "discrete",
        },
    }
    with tarfile.open(path, "w") as tar:
        _add(tar, "index.json", json.dumps(index).encode())
        for name, array in arrays.items():
            _add(tar, name, np.ascontiguousarray(array).data.cast("B"))


def _add(tar: tarfile.TarFile, name: str, content: bytes | memoryview) -> None:
    member = tarfile.TarInfo(name)
    member.size = len(content)
    tar.addfile(member, io.BytesIO(content))


def _offsets(sizes: NDArray[Any]) -> NDArray[np.uint64]:
    return np.concatenate((np.zeros(1, np.uint64), np.cumsum(sizes, dtype=np.uint64)))


def _bits(mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    packed = np.packbits(mask, bitorder="little")
    return np.pad(packed, (0, -len(packed) % 8))


def storm_model(path: Path) -> Any:
    """The model in Storm."""
    options = stormpy.io.UmbImportOptions()
    options.build_state_valuations = False
    return stormpy.build_model_from_umb(str(path), options=options)


def storm_labels(model: Any) -> tuple[Any, Any]:
    """Storm's states with P_min = 0 and with P_min = 1, as its bit vectors."""
    zero, one = stormpy.analysis.compute_prob01_states(model, stormpy.parse_property(FAIL))
    return zero, one


def storm_times(model: Any) -> Any:
    """Storm's check result with the survival time of every state."""
    return stormpy.model_checking(model, stormpy.parse_property(STEPS))


def mask(bits: Any, num_states: int) -> NDArray[np.bool_]:
    """A bit vector of Storm as a numpy mask."""
    result = np.zeros(num_states, dtype=np.bool_)
    result[np.fromiter(bits, dtype=np.int64)] = True
    return result


def times(result: Any) -> NDArray[np.float64]:
    """Storm's survival times as an array."""
    return np.array(result.get_value_vector(), dtype=np.float64)


def quantecon_model(next_state: NDArray[np.int32], fail: NDArray[np.bool_], beta: float) -> Any:
    """A DiscreteDP in state-action pairs; every action is available, fail stays put."""
    num_states, num_actions = next_state.shape
    pairs = num_states * num_actions
    target = np.where(fail[:, None], np.arange(num_states)[:, None], next_state).ravel()
    reward = np.where(np.repeat(~fail, num_actions) & fail[target], -1.0, 0.0)
    kernel = sparse.csr_matrix(
        (np.ones(pairs), target.astype(np.int32), np.arange(pairs + 1)), shape=(pairs, num_states)
    )
    states = np.repeat(np.arange(num_states), num_actions)
    actions = np.tile(np.arange(num_actions), num_states)
    return quantecon.markov.DiscreteDP(reward, kernel, beta, states, actions)


def quantecon_cost(model: Any) -> NDArray[np.float64]:
    """V by value iteration, run until it has converged within 1e-3."""
    result = model.solve(method="value_iteration", epsilon=1e-3, max_iter=10**9)
    return -np.asarray(result.v)
