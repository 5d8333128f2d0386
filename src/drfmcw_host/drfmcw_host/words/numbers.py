"""Numbers as people read them: fixed digits, so that a changing number does not jump, and '–' for none."""

import math

NONE = '–'


def distance(value: float) -> str:
    """Return a range [m] with millimetres."""
    return f'{value:.3f}' if math.isfinite(value) else NONE


def number(value: float, digits: int, scale: float = 1.0, sign: bool = False) -> str:
    """Return `value * scale` with a fixed number of decimals; '∞' for infinite values."""
    if math.isinf(value):
        return '∞' if value > 0 else '−∞'
    if math.isnan(value):
        return NONE
    return f'{value * scale:+.{digits}f}' if sign else f'{value * scale:.{digits}f}'


def span(seconds: float) -> str:
    """Return an age as '0.2 s', '42 s', '3:07 min', '2:05 h' or '4 d'."""
    if not math.isfinite(seconds):
        return NONE
    if seconds < 10.0:
        return f'{seconds:.1f} s'
    if seconds < 60.0:
        return f'{seconds:.0f} s'
    whole = int(seconds)
    if whole < 3600:
        return f'{whole // 60}:{whole % 60:02d} min'
    if whole < 172_800:
        return f'{whole // 3600}:{whole % 3600 // 60:02d} h'
    return f'{whole // 86_400} d'


def size(count: float) -> str:
    """Return a number of bytes as '812 MB' or '1.4 GB'."""
    for unit, factor in (('GB', 1e9), ('MB', 1e6), ('kB', 1e3)):
        if count >= factor:
            return f'{count / factor:.3g} {unit}'
    return f'{count:.0f} B'
