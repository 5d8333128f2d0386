"""The sentences on a measured remainder: what was learnt, how well it predicts, and statistics of what is random."""

import math

from . import quantities
from .limits import REPEATS
from .result import MeasuredCurve, MeasuredRemainder, RandomPart, Remainder

_OVER = {
    'range': 'the distance',
    'if_frequency': "the line's IF frequency",
    'board_temperature': 'the board temperature',
    'time': 'the time in the recording',
}


def sentences(rest: Remainder) -> list[str]:
    """Return what is said of a measured remainder."""
    measured = rest.measured
    if measured is None:
        return []
    judged = measured.held_out or measured.fitted
    on = 'held-out' if measured.held_out is not None else 'fitted'
    said = []
    if measured.curves:
        said = [
            f'What repeats of it was learnt from the data: it is measured, not physics. {_listed(measured)}.',
            f'On the {on} sweeps it lowers the misfit from {quantities.misfit(judged.before)} to '
            f'{quantities.misfit(judged.after)} and predicts {quantities.share(measured.repeats)} of what exceeds '
            'chance.',
        ]
        said += _elsewhere(measured)
    else:
        said = ['No smooth curve of it repeats from sweep to sweep, so none was learnt.']
    if rest.model:
        said.append('The refined model simulates it.')
    if measured.unmodelled:
        said.append(f'Not described by a curve: {", ".join(measured.unmodelled)}.')
    said += [x for part in measured.random if (x := random_sentence(part))]
    return said


def _listed(measured: MeasuredRemainder) -> str:
    return quantities.capital('; '.join(map(curve_words, measured.curves)))


def curve_words(curve: MeasuredCurve) -> str:
    """Return what a curve describes and how free it is, e.g. 'noise, slave: over the distance, 4.2 free values'."""
    over = f', changing over {_OVER[curve.axis]}' if curve.axis else ''
    if curve.terms is None or curve.freedom is None:
        return f'{curve.label}{over}'
    free = curve.terms * curve.freedom
    return f'{curve.label}{over} ({free:.0f} free value{"" if round(free) == 1 else "s"})'


def _elsewhere(measured: MeasuredRemainder) -> list[str]:
    """Return which curves do not hold between the points at which they were learnt."""
    poor = [c for c in measured.curves if c.axis and c.elsewhere is not None and c.elsewhere < REPEATS.elsewhere]
    if not poor:
        return []
    names = '; '.join(f'{c.label} (over {_OVER[c.axis]})' for c in poor)
    return [
        f'Left out of the learning, a point is predicted poorly by its neighbours: {names}. Such a curve '
        'holds only under the conditions of this recording.'
    ]


def random_sentence(part: RandomPart) -> str:
    """Return the statistics of what does not repeat at a station, '' where they are those of steady noise."""
    said = []
    beyond = [(a, b, x) for a, b, x in part.spectrum if x is not None and abs(x) > REPEATS.decibel]
    if beyond:
        low, high, level = max(beyond, key=lambda band: abs(band[2]))
        unit, shown = quantities.scaled(high, 'Hz')
        said.append(f'noise {level:+.1f} dB beyond the model at {low * unit:.0f} to {high * unit:.0f} {shown}')
    if part.strongest > REPEATS.steady:
        said.append(
            f'{quantities.share(part.strongest)} of the power beside the line in the strongest hundredth of the spans'
        )
    if part.sweep_std > REPEATS.sweep_decibel:
        said.append(f'a power beside the line that changes by {part.sweep_std:.1f} dB from sweep to sweep')
    if part.modulation is not None and math.isfinite(part.modulation):
        said.append(f'amplitude or phase modulated at {quantities.number(part.modulation, "Hz")} in each sweep anew')
    return f'Random from sweep to sweep at {part.station}: {"; ".join(said)}.' if said else ''
