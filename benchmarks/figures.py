"""One measured figure with what it is compared with: a bound, a reference measured in the same run, and its goal."""

import dataclasses
from typing import Any


def number(value: float | None) -> str:
    """Return four digits of a value, without an exponent where it is a rate; nothing for None."""
    if value is None:
        return ''
    return f'{value:.0f}' if 1e3 <= abs(value) < 1e7 else f'{value:.4g}'


@dataclasses.dataclass(frozen=True)
class Figure:
    """A measured value; `relation` says on which side of the goal it must lie."""

    name: str
    value: float
    unit: str = ''
    goal: float | None = None
    relation: str = '<='
    bound: float | None = None  # what physics allows at best
    reference: float | None = None  # the same job done by others, measured in the same run
    reference_name: str = ''

    @property
    def met(self) -> bool | None:
        """Whether the goal is met, None where there is none."""
        if self.goal is None:
            return None
        return bool(self.value <= self.goal if self.relation == '<=' else self.value >= self.goal)

    def as_object(self) -> dict[str, Any]:
        """Return a JSON-ready object."""
        return dataclasses.asdict(self) | {'met': self.met}
