"""Numbers as people read them: fixed digits, so that a changing number does not jump, and '–' for none.

The language decides the decimal sign: a comma in German.
"""

import math

NONE = '–'


def localised(text: str, language: str) -> str:
    """Return a number's text with the language's decimal sign."""
    return text.replace('.', ',') if language == 'de' else text


def distance(value: float, language: str) -> str:
    """Return a range [m] with millimetres."""
    return localised(f'{value:.3f}', language) if math.isfinite(value) else NONE


def number(value: float, digits: int, language: str, scale: float = 1.0, sign: bool = False) -> str:
    """Return `value * scale` with a fixed number of decimals; '∞' for infinite values."""
    if math.isinf(value):
        return '∞' if value > 0 else '−∞'
    if math.isnan(value):
        return NONE
    text = f'{value * scale:+.{digits}f}' if sign else f'{value * scale:.{digits}f}'
    return localised(text, language)


def general(value: float, digits: int, language: str, scale: float = 1.0, sign: bool = False) -> str:
    """Return `value * scale` with so many significant digits, as short as possible."""
    if not math.isfinite(value):
        return number(value, 0, language)
    return localised(f'{value * scale:{"+" if sign else ""}.{digits}g}', language)


def plus_minus(std: float, scale: float, language: str) -> str:
    """Return a standard deviation as '± 0.02'; a calibration states 0 for an unknown one: '± ?'."""
    return f'± {general(std, 2, language, scale) if std > 0.0 else "?"}'


def clock(value: float, std: float, language: str) -> str:
    """Return a frequency over its nominal value and its standard deviation as '+36.974 ± 0.02 ppm'."""
    return f'{number(value - 1.0, 3, language, 1e6, sign=True)} {plus_minus(std, 1e6, language)} ppm'


def deviation(std: float, language: str) -> str:
    """Return a range's standard deviation [m] as '± 5.09 mm', '± ?' where it is not known."""
    return f'± {number(std, 2, language, 1e3)} mm' if std > 0.0 else '± ?'


def span(seconds: float, language: str) -> str:
    """Return an age as '0.2 s', '42 s', '3:07 min', '2:05 h' or '4 d'."""
    if not math.isfinite(seconds):
        return NONE
    if seconds < 10.0:
        return f'{number(seconds, 1, language)} s'
    if seconds < 60.0:
        return f'{seconds:.0f} s'
    whole = int(seconds)
    if whole < 3600:
        return f'{whole // 60}:{whole % 60:02d} min'
    if whole < 172_800:
        return f'{whole // 3600}:{whole % 3600 // 60:02d} h'
    return f'{whole // 86_400} d'


def size(count: float, language: str) -> str:
    """Return a number of bytes as '812 MB' or '1.4 GB'."""
    for unit, factor in (('GB', 1e9), ('MB', 1e6), ('kB', 1e3)):
        if count >= factor:
            return f'{general(count / factor, 3, language)} {unit}'
    return f'{count:.0f} B'
