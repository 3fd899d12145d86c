"""Stable-Baselines3's SAC with our settings, for the benchmarks beside it.

What differs still: its weights are initialised as PyTorch does it, ours Xavier-uniform, and it
sees observations as they are, ours centred and scaled by those of the random start.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3 import SAC
from stable_baselines3.common.logger import Logger

from deep.train.sac import SacSettings

__all__ = ["Idle", "filled_sac", "stable_baselines3_sac"]


class Idle(gymnasium.Env[NDArray[Any], NDArray[Any]]):
    """Spaces of the given dimensions, in which nothing ever happens."""

    def __init__(self, observation_dim: int, action_dim: int) -> None:
        self.observation_space = spaces.Box(-10.0, 10.0, (observation_dim,), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (action_dim,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[Any], dict[str, Any]]:
        """Zeros."""
        super().reset(seed=seed, options=options)
        return np.zeros(self.observation_space.shape or (), dtype=np.float32), {}

    def step(
        self,
        action: NDArray[Any],  # noqa: ARG002  (Gymnasium's signature)
    ) -> tuple[NDArray[Any], float, bool, bool, dict[str, Any]]:
        """Zeros."""
        return self.reset()[0], 0.0, False, False, {}


def stable_baselines3_sac(
    env: gymnasium.Env[Any, Any],
    settings: SacSettings,
    *,
    seed: int,
    start_steps: int,
    replay: int,
) -> SAC:
    """One update a step after the start, a constant rate, and a fixed temperature.

    Raises:
        ValueError: if the settings slow the learning rate down or scale rewards.
    """
    if settings.final_rate != 1 or settings.reward_scale != 1:
        raise ValueError("only a constant learning rate and unscaled rewards are compared")
    model = SAC(
        "MlpPolicy",
        env,
        learning_rate=settings.learning_rate,
        buffer_size=replay,
        learning_starts=start_steps,
        batch_size=settings.batch_size,
        tau=settings.polyak,
        gamma=settings.gamma,
        train_freq=1,
        gradient_steps=1,
        ent_coef=settings.temperature,
        policy_kwargs={"net_arch": list(settings.hidden)},
        seed=seed,
        device="cpu",
    )
    model.set_logger(Logger(None, []))
    return model


def filled_sac(settings: SacSettings, observation_dim: int, action_dim: int, replay: int) -> SAC:
    """A learner without an environment, its replay buffer full of noise."""
    env = Idle(observation_dim, action_dim)
    model = stable_baselines3_sac(env, settings, seed=0, start_steps=0, replay=replay)
    buffer, rng = model.replay_buffer, np.random.default_rng(0)
    assert buffer is not None
    for name in ("observations", "next_observations", "rewards"):
        part = getattr(buffer, name)
        part[:] = rng.standard_normal(part.shape, dtype=np.float32)
    buffer.actions[:] = rng.uniform(-1, 1, buffer.actions.shape)
    buffer.full = True
    return model
