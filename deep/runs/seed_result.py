"""What a run's ``result.json`` says of its seeds and of what it cost; needs no torch to be read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from deep.runs.record import Record

__all__ = ["Budget", "SeedResult", "read_seeds"]


class Evaluated(Protocol):
    """The metrics of whole episodes."""

    @property
    def acr(self) -> float: ...
    @property
    def avr(self) -> float: ...
    @property
    def arr(self) -> float: ...
    @property
    def length(self) -> float: ...


@dataclass(frozen=True)
class SeedResult:
    """What one seed ended with.

    Attributes:
        seed: the seed.
        tv: violations during training; None where nothing was trained.
        episodes: of the training; None where nothing was trained.
        acr: average cumulative reward over the evaluation's whole episodes.
        avr: share of them that end in a violation.
        arr: share of their steps that were corrected.
        length: their mean number of steps.
        training_arr: share of the training's steps that were corrected, or None.
        threshold: epsilon, or WCSAC's cost limit; None without either.
    """

    seed: int
    tv: int | None
    episodes: int | None
    acr: float
    avr: float
    arr: float
    length: float
    training_arr: float | None
    threshold: float | None

    @classmethod
    def of(
        cls,
        seed: int,
        evaluated: Evaluated,
        *,
        tv: int | None = None,
        episodes: int | None = None,
        training_arr: float | None = None,
        threshold: float | None = None,
    ) -> SeedResult:
        """What training counted, and the evaluation's metrics."""
        e = evaluated
        return cls(seed, tv, episodes, e.acr, e.avr, e.arr, e.length, training_arr, threshold)

    @classmethod
    def from_record(cls, record: Record) -> SeedResult:
        """An entry of ``seeds`` in ``result.json``, which has the fields' names."""
        return cls(
            seed=record.count("seed"),
            tv=record.maybe("tv", record.count),
            episodes=record.maybe("episodes", record.count),
            acr=record.number("acr"),
            avr=record.share("avr"),
            arr=record.share("arr"),
            length=record.number("length"),
            training_arr=record.maybe("training_arr", record.share),
            threshold=record.maybe("threshold", record.amount),
        )


@dataclass(frozen=True)
class Budget:
    """What a run cost: steps, updates and episodes of each seed, seconds of all together."""

    env_steps: int | None
    updates: int | None
    wall_seconds: float
    evaluation_episodes: int

    @classmethod
    def from_record(cls, record: Record) -> Budget:
        """``budget`` in ``result.json``, which has the fields' names."""
        return cls(
            env_steps=record.maybe("env_steps", record.count),
            updates=record.maybe("updates", record.count),
            wall_seconds=record.number("wall_seconds"),
            evaluation_episodes=record.count("evaluation_episodes"),
        )


def read_seeds(result: Record) -> tuple[SeedResult, ...]:
    """The seeds of a ``result.json``.

    Raises:
        ValueError: if there are none, or one is there twice, or what it says is wrong.
    """
    seeds = tuple(SeedResult.from_record(seed) for seed in result.records("seeds"))
    if not seeds or len({seed.seed for seed in seeds}) < len(seeds):
        raise ValueError(f"{result.place}: seeds must be there, and none twice")
    return seeds
