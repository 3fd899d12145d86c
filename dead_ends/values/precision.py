"""What to say where rounded numbers do not decide what was asked."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

__all__ = ["UndecidedError"]

OPTIONS = {
    "exact": "use --exact",
    "gamma_safe": "a --gamma-safe below 1",
    "epsilon_safe": "an --epsilon-safe that is farther away",
}
"""How a command line says what helps, by the library's argument."""


class UndecidedError(ValueError):
    """Floats leave a question open; the message says what helps.

    Args:
        fact: what is known, and what is not.
        remedies: what helps, by the argument that it is about, such as
            ``{"exact": "use exact=True"}``.

    Attributes:
        fact, remedies: the same.
    """

    def __init__(self, fact: str, remedies: Mapping[str, str]) -> None:
        super().__init__(_sentence(fact, remedies.values()))
        self.fact, self.remedies = fact, dict(remedies)

    def with_options(self, known: Iterable[str]) -> str:
        """The message of a command, which names those remedies for which it has an option.

        Args:
            known: the names of the command's options, with underscores.
        """
        names = set(known)
        helps = [name for name in self.remedies if name in OPTIONS and name in names]
        return _sentence(self.fact, (OPTIONS[name] for name in helps))


def _sentence(fact: str, advice: Iterable[str]) -> str:
    text = ", or ".join(advice)
    return f"{fact}: {text}" if text else fact
