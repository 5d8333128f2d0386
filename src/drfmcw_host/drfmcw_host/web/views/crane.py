"""The picture of the crane on its rail: SVG whose moving parts the stream shifts."""

import math

WIDTH, HEIGHT = 1000, 190
"""Of the picture, in its own units."""

LEFT, RIGHT = 60, 950
"""Where the rail begins and ends."""

TICKS = 5
"""Intervals of the scale."""

_LENGTHS = (10, 20, 50, 100, 200, 500, 1000, 1500, 2000, 5000, 10_000)  # of a rail that can be shown [m]


def rail_length(largest: float) -> float:
    """Return the length to show for ranges up to `largest` [m]."""
    if not math.isfinite(largest):
        return _LENGTHS[0]
    return next((length for length in _LENGTHS if largest <= length), 10.0 ** math.ceil(math.log10(largest)))


def position(distance: float, length: float) -> float:
    """Return where a crane at `distance` [m] stands on a rail of `length` [m]."""
    share = distance / length if math.isfinite(distance) else 0.0
    return LEFT + min(max(share, 0.0), 1.0) * (RIGHT - LEFT)


def picture() -> str:
    """Return the picture; texts and positions come by the stream under crane, beam and tick.N."""
    marks = []
    for i in range(TICKS + 1):
        x = LEFT + i * (RIGHT - LEFT) / TICKS
        marks.append(f'<path class="tick" d="M{x:g} 150v9"/>')
        marks.append(f'<text class="tick-text" x="{x:g}" y="180" data-field="tick.{i}"></text>')
    sleepers = ''.join(f'<path class="sleeper" d="M{x} 150v5"/>' for x in range(LEFT - 20, RIGHT + 30, 14))
    return f"""<svg viewBox="0 0 {WIDTH} {HEIGHT}" class="crane" aria-hidden="true" focusable="false">
<path class="rail" d="M{LEFT - 24} 149H{RIGHT + 28}"/>{sleepers}{''.join(marks)}
<g class="mast"><path d="M{LEFT - 16} 148V58M{LEFT - 26} 148h20"/>
<path class="dish" d="M{LEFT - 16} 52q14 12 0 24z"/></g>
<path class="beam" data-field="beam" d="M{LEFT} 64H{LEFT}"/>
<g data-field="crane" class="gantry" transform="translate({LEFT} 0)">
<path class="steel" d="M-2 30H58V40H-2zM4 40V140M52 40V140M4 72L52 104M52 72L4 104"/>
<path class="cab" d="M30 40h16v14H30z"/><path class="rope" d="M17 40v52"/><path class="load" d="M8 92h18v14H8z"/>
<path class="bogie" d="M-4 140h16v4H-4zM44 140h16v4H44z"/>
<circle cx="0" cy="145" r="4"/><circle cx="8" cy="145" r="4"/>
<circle cx="48" cy="145" r="4"/><circle cx="56" cy="145" r="4"/>
<path class="dish" d="M0 52q-14 12 0 24z"/></g></svg>"""
