"""From a pretraining run's folder to the correction of an online run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch

from deep.data.minibatches import Batches
from deep.data.normalisation import Ranges, TensorNormalisation
from deep.filter.safety_filter import SafetyFilter
from deep.pretraining import Learner, RrlMsdpSettings, RrlSettings, build_learner
from deep.pretraining.config import PretrainConfig
from deep.pretraining.run import load_raw, read_run
from deep.runs.checkpoint import load_checkpoint
from deep.tasks.bounds import Bounds
from deep.tasks.task import Sizes
from deep.tasks.vectorised import check_fit
from deep.train.config import TrainConfig
from deep.train.correction import (
    FinetunedCorrection,
    FrozenCorrection,
    NoCorrection,
    TrainingCorrection,
)

__all__ = ["build_correction", "load_filters"]


def build_correction(config: TrainConfig, sizes: Sizes, actions: Bounds) -> TrainingCorrection:
    """The correction that the configuration asks for; none without a pretraining run.

    ``sizes`` and ``actions``, the action bounds, are the task's.

    Raises:
        ValueError: if the pretraining run is missing, unfinished, or does not fit the task.
    """
    if config.safety is None:
        return NoCorrection()
    pretrained = read_run(config.safety)
    seeds = config.safety_seeds or config.seeds
    filters = _filters(config, pretrained, seeds)
    for safety in filters:
        found = Sizes(safety.observation_dim, safety.action_dim)
        check_fit(f"{config.safety}: its filters take", found, config.task, sizes)
    filters = [safety.for_actions(actions, config.task) for safety in filters]
    finetune = config.finetune
    if finetune is None:
        finetune = isinstance(pretrained.method, RrlSettings | RrlMsdpSettings)
    if not finetune:
        return FrozenCorrection(filters)
    learner = _learner(config.safety, pretrained, sizes, config.seeds, seeds)
    thresholds = [safety.threshold for safety in filters]
    data, _ = load_raw(pretrained)
    if len(data) > 1:
        data = [data[pretrained.seeds.index(seed)] for seed in seeds]
    offline = Batches(
        data,
        config.seeds,
        config.method.batch_size // 2,
        pretrained.method.violation_share,
        torch.device("cpu"),
    )
    normalisation = TensorNormalisation([safety.normalisation for safety in filters])
    ranges = [Ranges(safety.actions, safety.observations) for safety in filters]
    return FinetunedCorrection(
        learner, thresholds, normalisation, ranges, filters[0].gamma_safe, offline
    )


def _filters(
    config: TrainConfig, pretrained: PretrainConfig, seeds: Sequence[int]
) -> list[SafetyFilter]:
    """The filters of these seeds of the pretraining, with the run's own thresholds."""
    assert config.safety is not None
    unknown = [seed for seed in seeds if seed not in pretrained.seeds]
    if unknown:
        raise ValueError(
            f"{config.safety}: seed {unknown[0]} was not pretrained; there are "
            f"{', '.join(map(str, pretrained.seeds))}"
        )
    filters = load_filters(config.safety, seeds)
    if config.thresholds is None:
        return filters
    return [f.with_threshold(t) for f, t in zip(filters, config.thresholds, strict=True)]


def load_filters(folder: Path, seeds: Sequence[int]) -> list[SafetyFilter]:
    """The filters of these seeds in a run's folder.

    Raises:
        ValueError: if there is none of a seed, or a broken one.
    """
    filters = []
    for seed in seeds:
        name = f"filters/seed{seed}.safetensors"
        if not (folder / name).is_file():
            raise ValueError(f"{folder}: not a finished pretraining run of seed {seed} (no {name})")
        filters.append(SafetyFilter.load(folder / name))
    return filters


def _learner(
    folder: Path,
    pretrained: PretrainConfig,
    sizes: Sizes,
    seeds: Sequence[int],
    safety_seeds: Sequence[int],
) -> Learner:
    """A learner whose seed k goes on from what ``safety_seeds[k]`` was pretrained to."""
    source = build_learner(pretrained.method, sizes, pretrained.seeds)
    load_checkpoint(source, folder / "checkpoint.safetensors")
    learner = build_learner(pretrained.method, sizes, seeds)
    picked = torch.tensor([pretrained.seeds.index(seed) for seed in safety_seeds])
    old = source.state_dict()
    learner.load_state_dict(
        {name: _rows(tensor, len(pretrained.seeds), picked) for name, tensor in old.items()}
    )
    return learner


def _rows(tensor: torch.Tensor, seeds: int, picked: torch.Tensor) -> torch.Tensor:
    """The picked seeds' rows of a (seeds * members, ...) tensor."""
    by_seed = tensor.view(seeds, -1, *tensor.shape[1:])
    return by_seed[picked].reshape(-1, *tensor.shape[1:])
