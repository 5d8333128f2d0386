"""The strip of verdicts over time: SVG in which a level shows by its height as well as by its colour."""

import html
from collections.abc import Sequence

from ...state.verdicts import Span

WIDTH, HEIGHT = 1000, 40
"""Of the picture, in its own units; a page stretches it in width alone."""

STATES = {0: 'good', 1: 'doubtful', 2: 'unusable', 3: 'stale'}
"""Level: state."""

_HEIGHTS = {0: 12, 1: 26, 2: 26, 3: 4}
_MARK = 4  # half the width of a finding's mark


def picture(spans: Sequence[Span], findings: Sequence[float], begin: float, end: float, label: str) -> str:
    """Return the strip from `begin` to `end`.

    Args:
        spans: what was said.
        findings: when findings were made (wall clock [s]).
        begin: of the strip (wall clock [s]).
        end: of the strip.
        label: text for who does not see it.
    """

    def place(when: float) -> float:
        return round(min(max((when - begin) / (end - begin), 0.0), 1.0) * WIDTH, 1)

    bars = []
    for span in spans:
        left, height = place(span.begin), _HEIGHTS[min(span.level, 3)]
        width = max(place(span.end) - left, 1.0)
        bars.append(
            f'<rect data-state="{STATES[min(span.level, 3)]}" x="{left}" y="{HEIGHT - height}" '
            f'width="{width}" height="{height}"/>'
        )
    marks = [
        f'<path class="mark" d="M{x - _MARK} 0h{2 * _MARK}l{-_MARK} 10z"/>'
        for x in (place(when) for when in findings if begin <= when <= end)
    ]
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" preserveAspectRatio="none" class="strip" role="img" '
        f'aria-label="{html.escape(label)}">{"".join(bars)}{"".join(marks)}</svg>'
    )
