"""Quantities in text: numbers with sensible digits, scaled units, standard deviations, shares and misfits."""

import math

_UNITS = {'1': '', '1e-6': '·10⁻⁶', 'm^2': 'm²', 'degC': '°C'}
_PREFIXES = {  # {unit: (smallest shown [unit], factor, shown as), ...}, the first that fits is taken
    'Hz': ((1e9, 1e-9, 'GHz'), (1e6, 1e-6, 'MHz'), (1e4, 1e-3, 'kHz'), (1.0, 1.0, 'Hz'), (0.0, 1e3, 'mHz')),
    's': ((1.0, 1.0, 's'), (1e-3, 1e3, 'ms'), (1e-6, 1e6, 'µs'), (0.0, 1e9, 'ns')),
    'm': ((1.0, 1.0, 'm'), (0.0, 1e3, 'mm')),
}


def symbol(unit: str) -> str:
    """Return a unit as shown."""
    return _UNITS.get(unit, unit)


def scaled(magnitude: float, unit: str) -> tuple[float, str]:
    """Return the (factor, unit as shown) that suit a number of size `magnitude` [unit]."""
    if not magnitude:
        return 1.0, symbol(unit)
    for smallest, factor, shown in _PREFIXES.get(unit, ()):
        if abs(magnitude) >= smallest:
            return factor, shown
    return 1.0, symbol(unit)


def plain(value: float, digits: int = 3) -> str:
    """Return a number with `digits` significant digits, without an exponent if it is neither tiny nor huge."""
    if not math.isfinite(value):
        return 'unknown'
    if value == 0.0:
        return '0'
    written = f'{value:.{digits - 1}e}'
    exponent = int(written.partition('e')[2])
    if not -5 < exponent < 7:
        return written
    return f'{round(value, digits - 1 - exponent):.{max(0, digits - 1 - exponent)}f}'


def number(value: float, unit: str, digits: int = 3, sign: bool = False) -> str:
    """Return a number with its unit, scaled."""
    factor, shown = scaled(value, unit)
    return f'{"+" if sign and value > 0.0 else ""}{plain(value * factor, digits)}{gap(shown)}'


def quantity(value: float, std: float, unit: str) -> str:
    """Return 'value ± std unit': one digit of the std, two if it begins with 1 or 2; the value to the same decimal."""
    if not math.isfinite(std) or std <= 0.0:
        return f'{number(value, unit, 4)} (uncertainty unknown)'
    factor, shown = scaled(max(abs(value), std), unit)
    value, std = value * factor, std * factor
    exponent = math.floor(math.log10(std))
    decimals = -exponent + (float(f'{std:.1e}') < 3.0 * 10.0**exponent)
    if decimals > 9 or exponent > 6:
        return f'{value:.6g} ± {std:.2g} {shown}'.strip()
    shown_decimals = max(0, decimals)
    text = f'{round(value, decimals):.{shown_decimals}f} ± {round(std, decimals):.{shown_decimals}f}'
    return f'({text}){shown}' if shown.startswith('·') else f'{text}{gap(shown)}'


def gap(unit: str) -> str:
    """Return a unit as shown behind a number, with the space that belongs there."""
    return f' {unit}' if unit and not unit.startswith('·') else unit


def misfit(value: float) -> str:
    """Return a misfit per degree of freedom."""
    return f'{value:.2f}' if abs(value) < 9.995 else plain(value, 3)


def share(value: float) -> str:
    """Return a share in per cent."""
    if not math.isfinite(value):
        return 'unknown'
    percent = 100.0 * value
    return 'less than 1 %' if 0.0 < percent < 0.5 else f'{percent:.0f} %'


def capital(text: str) -> str:
    """Return the text with a capital first letter."""
    return text[:1].upper() + text[1:]
