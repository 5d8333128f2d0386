"""A diagnosis in plain sentences: numbers with sensible digits, effects as their own declarations describe them."""

import dataclasses
import math
import re
from collections.abc import Sequence

import numpy as np

from drfmcw_physics.settings import declared_parameters
from drfmcw_sim.effects import Effect, Of

from . import repeating
from .limits import SENTENCES, SEPARATION
from .quantities import capital, gap, misfit, number, plain, quantity, scaled, share, symbol
from .result import BeforeAfter, Diagnosis, Explanation, FoundEffect, Location, NextMeasurement

AXES = {
    'ramp_time': ('time in the sweep', 's'),
    'if_frequency': ('IF frequency', 'Hz'),
    'range': ('distance', 'm'),
    'time': ('time in the recording', 's'),
    'board_temperature': ('board temperature', 'degC'),
    'velocity': ('velocity', 'm/s'),
    'adc_code': ('ADC code', 'LSB'),
}
"""Axes of locations and series: {name: (in words, unit)}; other axes are shown by their names."""

LEVEL_WORDS = {
    'if_samples': 'IF signal',
    'if_spectrum': 'IF spectrum',
    'beat_frequency': 'beat frequency',
    'amplitude': 'received amplitude',
    'noise': 'noise',
    'range': 'range',
}

_IDEAL = 'A correct model gives 1.'


def chance(probability: float) -> str:
    """Return a probability as '43 of 100 recordings' or '1 of 10 000 recordings'."""
    if not math.isfinite(probability):
        return 'an unknown share of recordings'
    if probability < 1e-6:
        return 'fewer than 1 of a million recordings'
    if probability >= 0.095:
        return f'{100.0 * probability:.0f} of 100 recordings'
    return f'1 of {_grouped(1.0 / probability)} recordings'


def odds(log_gain: float) -> str:
    """Return exp(log_gain) as 'equally', '3.2 times as' or 'more than a million times as'."""
    if log_gain < 0.1:
        return 'equally'
    if log_gain > math.log(1e6):
        return 'more than a million times as'
    ratio = math.exp(log_gain)
    return f'{ratio:.1f} times as' if ratio < 10.0 else f'{_grouped(ratio)} times as'


def _grouped(value: float) -> str:
    """Return a whole number with two significant digits, in groups of three."""
    if value >= 100.0:
        value = round(value, 1 - math.floor(math.log10(value)))
    text = f'{value:,.0f}'
    return text.replace(',', ' ') if value >= 10_000 else text.replace(',', '')


def span(location: Location) -> str:
    """Return the interval of a location on its axis, e.g. 'time in the sweep 0.10 to 0.95 ms'."""
    name, unit = axis(location.axis)
    if not (math.isfinite(location.start) and math.isfinite(location.end)):
        return f'every {name}'
    factor, shown = scaled(max(abs(location.start), abs(location.end)), unit)
    start, end = location.start * factor, location.end * factor
    if end <= start:
        return f'{name} {plain(start)}{gap(shown)}'
    decimals = max(0, 1 - math.floor(math.log10(end - start)))
    return f'{name} {start:.{decimals}f} to {end:.{decimals}f}{gap(shown)}'


def axis(name: str) -> tuple[str, str]:
    """Return (words, unit) of an axis."""
    return AXES.get(name, (name.replace('_', ' '), ''))


def level_title(level: str, station: str | None) -> str:
    """Return level and station in words, e.g. 'IF signal of master'."""
    words = LEVEL_WORDS.get(level, level.replace('_', ' '))
    return f'{words} of {station}' if station else words


@dataclasses.dataclass(frozen=True)
class ParameterWords:
    """One parameter of an effect as shown."""

    name: str
    size: str  # with standard deviation and unit
    description: str  # '' if the parameter before it has the same


@dataclasses.dataclass(frozen=True)
class EffectWords:
    """One effect as shown, from its declarations."""

    title: str  # 'sweep ripple at master'
    headline: str  # 'the ramp ripples'
    description: str  # sentences
    formula: str
    parameters: tuple[ParameterWords, ...]


def effect_words(found: FoundEffect) -> EffectWords:
    """Describe an effect of an explanation by the docstrings and declarations of its class.

    Raises:
        KeyError: the registry has no such effect, or the effect no such parameter.
    """
    cls = Effect.registry[found.effect]
    declared = declared_parameters(cls)
    parameters, seen = [], set()
    for name, estimate in found.parameters.items():
        base = parameter_name(name)
        size = quantity(estimate.value, estimate.std, estimate.unit)
        description = '' if base in seen else declared[base][1].description
        seen.add(base)
        parameters.append(ParameterWords(name.replace('_', ' '), size, description))
    return EffectWords(
        effect_title(found),
        cls.headline[0].lower() + cls.headline[1:].rstrip('.'),
        ' '.join(str(cls.__doc__).split()),
        cls.formula,
        tuple(parameters),
    )


def parameter_name(name: str) -> str:
    """Return the declared name of a parameter, 'velocity' for the 'velocity[3]' of a list."""
    return re.sub(r'\[\d+\]$', '', name)


def effect_title(found: FoundEffect) -> str:
    """Return name and station of an effect, e.g. 'sweep ripple at master'."""
    cls = Effect.registry[found.effect]
    if found.station:
        return f'{cls.title} at {found.station}'
    where = {Of.STATION: ' at all stations', Of.PATH: ' on the path', Of.REFERENCE: ''}
    return cls.title + where[cls.of]


def explanation_title(explanation: Explanation) -> str:
    """Return the titles of an explanation's effects, joined."""
    return ' + '.join(map(effect_title, explanation.effects)) or 'nothing added'


def effect_sentence(found: FoundEffect) -> str:
    """Return what an effect is, where it acts, how large it is, and how it changes the range."""
    words = effect_words(found)
    sizes = ', '.join(f'{p.name} {p.size}' + (f' ({p.description})' if p.description else '') for p in words.parameters)
    if len(words.parameters) > SENTENCES.parameters:
        values = [estimate.value for estimate in found.parameters.values()]
        first = next(iter(found.parameters))
        name = parameter_name(first).replace('_', ' ')
        sizes = f'{name}: {len(values)} values from {plain(min(values))} to {plain(max(values))}'
        sizes += f'{gap(symbol(found.parameters[first].unit))}'
    text = f'{capital(words.title)}: {words.headline}. {_first_sentence(words.description)}'
    if sizes:
        text += f' {capital(sizes)}.'
    if found.range_shift is not None:
        text += f' It changes the range in this recording by up to {millimetres(found.range_shift)[0]}.'
    return text


def millimetres(*values: float, sign: bool = True) -> list[str]:
    """Return lengths in mm, all with the same decimals; in m if one is 10 m or more."""
    largest = max(map(abs, values))
    if not largest < 10.0:
        return [number(value, 'm', sign=sign) for value in values]
    texts = [f'{1e3 * value:{"+" if sign else ""}.{2 if largest < 1e-3 else 1}f}' for value in values]
    return [f'{text.lstrip("+-") if float(text) == 0.0 else text} mm' for text in texts]


def _first_sentence(text: str | None) -> str:
    return re.split(r'(?<=[.])\s+(?=[A-Z])', ' '.join(str(text).split()), maxsplit=1)[0]


@dataclasses.dataclass(frozen=True)
class Paragraph:
    """Sentences under a heading."""

    heading: str
    sentences: tuple[str, ...]


def headline(diagnosis: Diagnosis) -> str:
    """Return the verdict in one line."""
    if diagnosis.verdict == 'consistent':
        return 'The model explains this recording'
    if diagnosis.verdict == 'unexplained':
        return 'The model does not match this recording, and no known effect explains why'
    if diagnosis.verdict == 'ambiguous':
        return 'The model does not match this recording, and several explanations fit equally well'
    title = capital(_explained(diagnosis).replace(' + ', ' and '))
    return f'{title}, and something that no known effect explains' if diagnosis.verdict == 'partial' else title


def _explained(diagnosis: Diagnosis) -> str:
    return explanation_title(diagnosis.explanation) if diagnosis.explanation else 'nothing added'


def paragraphs(diagnosis: Diagnosis) -> tuple[Paragraph, ...]:
    """Return the finding in plain sentences, in the order of a reader's questions."""
    parts = [
        Paragraph('Finding', tuple(_finding(diagnosis))),
        Paragraph('Where', tuple(_where(diagnosis))),
        Paragraph('How sure', tuple(_certainty(diagnosis))),
        Paragraph('Remainder', tuple(_remainder(diagnosis))),
        Paragraph('Fit', tuple(_fit(diagnosis))),
        Paragraph('Range', tuple(_range(diagnosis))),
        Paragraph('Rivals', tuple(_rivals(diagnosis))),
        Paragraph('Next', tuple(_next(diagnosis))),
        Paragraph('Not tested', tuple(map(_closed, diagnosis.not_testable))),
    ]
    said = {sentence for part in parts for sentence in part.sentences}
    parts.append(Paragraph('Also', tuple(s for s in diagnosis.sentences if s not in said)))
    return tuple(part for part in parts if part.sentences)


def sentences(diagnosis: Diagnosis) -> tuple[str, ...]:
    """Return the finding in plain sentences; further sentences that the diagnosis holds come last."""
    return tuple(sentence for part in paragraphs(diagnosis) for sentence in part.sentences)


def _finding(diagnosis: Diagnosis) -> list[str]:
    effects = diagnosis.explanation.effects if diagnosis.explanation else ()
    if diagnosis.verdict == 'consistent':
        return ['The model explains the recording: no mismatch exceeds chance.']
    if diagnosis.verdict == 'unexplained':
        said = ['The model does not match the recording. No effect in the registry explains the mismatch.']
        if effects:
            said.append(f'The best explanation found, {_explained(diagnosis)}, does not remove it.')
        return said
    if diagnosis.verdict == 'ambiguous':
        said = [
            'The model does not match the recording. Several explanations fit equally well, and this recording cannot '
            'separate them. The most probable one comes first.'
        ]
    elif diagnosis.verdict == 'partial':
        one = len(effects) == 1
        said = [
            f'The model does not match the recording. {"One effect" if one else _count(len(effects), "effect")} '
            f'{"is" if one else "are"} there beyond doubt, but {"it does" if one else "they do"} not explain the whole '
            'mismatch.'
        ]
    elif len(effects) == 1:
        said = ['The model does not match the recording. One effect explains the mismatch.']
    else:
        said = [f'The model does not match the recording. {len(effects)} effects together explain the mismatch.']
    said += map(effect_sentence, effects)
    shift = range_change(diagnosis)
    if shift and all(e.range_shift is None for e in effects):
        said.append(f'Together they change the range in this recording by up to {millimetres(shift)[0]}.')
    return said


def range_change(diagnosis: Diagnosis) -> float | None:
    """Return the largest change of a range by the explanation, with its sign [m]; None without a series of it."""
    of_range = (s for s in diagnosis.series if (s.level, s.axis) == ('range', 'range'))
    curves = [s.curve for s in of_range if np.isfinite(s.curve).any()]
    if not curves:
        return None
    curve = np.concatenate(curves)
    return float(curve[np.nanargmax(np.abs(curve))])


def _where(diagnosis: Diagnosis) -> list[str]:
    if diagnosis.verdict == 'consistent' or not diagnosis.locations:
        return []
    return [f'Contributions to the excess misfit: {_contributions(diagnosis.locations)}.']


def _contributions(locations: Sequence[Location]) -> str:
    ordered = sorted(locations, key=lambda x: -x.share)
    said = [f'{level_title(x.level, x.station)}, {span(x)}: {share(x.share)}' for x in ordered[: SENTENCES.listed]]
    more = len(ordered) - len(said)
    end = f'; and {_count(more, "smaller contribution")}' if more else ''
    return '; '.join(said) + end


def _remainder(diagnosis: Diagnosis) -> list[str]:
    rest = diagnosis.remainder
    if rest is None:
        return []
    if diagnosis.explanation is None:
        return repeating.sentences(rest)
    said = [
        f'The effects leave {share(rest.share)} of the excess misfit. Chance alone leaves so much in '
        f'{chance(rest.probability)}.'
    ]
    if diagnosis.verdict not in ('partial', 'ambiguous'):
        said.append('That is as little as the forward models themselves may be off.')
    if rest.locations:
        said.append(f'It lies in: {_contributions(rest.locations)}.')
    return said + repeating.sentences(rest)


def _certainty(diagnosis: Diagnosis) -> list[str]:
    largest = 'the largest one here' if diagnosis.verdict == 'consistent' else 'this one'
    said = [
        f'Chance alone produces a mismatch as large as {largest} in {chance(diagnosis.significance)}; '
        'the figure is corrected for every position searched.',
        f'The threshold accepts a false alarm in {chance(diagnosis.false_alarm_rate)}.',
    ]
    effects = diagnosis.explanation.effects if diagnosis.explanation else ()
    if len(effects) > 1:
        said += [
            f'{capital(effect_title(e))}: with the other effects kept, the data are {odds(e.log_evidence_gain)} '
            f'probable with it as without it. Chance alone produces such a gain in {chance(e.p_value)}.'
            for e in effects
        ]
    return said


def _fit(diagnosis: Diagnosis) -> list[str]:
    shown = diagnosis.fit.held_out
    on = 'the held-out sweeps'
    if not math.isfinite(shown.before):
        shown, on = diagnosis.fit.fitted, 'the fitted sweeps, which are too few to hold any out'
    elif diagnosis.sweeps_fitted is not None and diagnosis.sweeps_held_out is not None:
        on += f' ({diagnosis.sweeps_held_out} of {diagnosis.sweeps_fitted + diagnosis.sweeps_held_out})'
    if not math.isfinite(shown.before):
        return []
    if diagnosis.explanation is None:
        return [f'Misfit per degree of freedom on {on}: {misfit(shown.before)}. {_IDEAL}']
    return [f'Misfit per degree of freedom on {on}: {_change(shown)}. {_IDEAL}']


def _change(figure: BeforeAfter) -> str:
    return f'{misfit(figure.before)} without the explanation, {misfit(figure.after)} with it'


def _range(diagnosis: Diagnosis) -> list[str]:
    said = []
    for name, figure, sign in (
        ('mean', diagnosis.fit.range_bias, True),
        ('standard deviation', diagnosis.fit.range_std, False),
    ):
        if figure is not None:
            before, after = millimetres(figure.before, figure.after, sign=sign)
            with_it = f' without the explanation, {after} with it' if diagnosis.explanation else ''
            said.append(f'{name} {before}{with_it}')
    return [f'Range error against the reference: {"; ".join(said)}.'] if said else []


def _rivals(diagnosis: Diagnosis) -> list[str]:
    if diagnosis.explanation is None or not diagnosis.alternatives:
        return []
    best = diagnosis.explanation.log_evidence_gain
    if diagnosis.verdict == 'explained':
        rival = diagnosis.alternatives[0]
        return [
            f'The second-best explanation is {explanation_title(rival)}. The explanation above is '
            f'{odds(best - rival.log_evidence_gain)} probable.'
        ]
    shown = diagnosis.alternatives[: SENTENCES.listed]
    said = [
        f'Another explanation is {with_sizes(rival)}. The first one is {odds(best - rival.log_evidence_gain)} probable.'
        for rival in shown
    ]
    more = len(diagnosis.alternatives) - len(shown)
    return [*said, f'{_count(more, "further explanation")} also fit.'] if more else said


def with_sizes(explanation: Explanation) -> str:
    """Return the titles of an explanation's effects with their parameters."""
    return ' with '.join(
        f'{effect_title(e)} ({", ".join(f"{p.name} {p.size}" for p in effect_words(e).parameters)})'
        for e in explanation.effects
    )


def _next(diagnosis: Diagnosis) -> list[str]:
    said = [f'Decisive measurement: {_closed(diagnosis.next_measurement)}'] if diagnosis.next_measurement else []
    if not diagnosis.measurements:
        return said
    best, *others = diagnosis.measurements
    tried = f'{_count(len(diagnosis.measurements), "measurement")} simulated under every explanation'
    if not best.decides:
        if best.separation < SEPARATION.informative:
            return [*said, f'Of {tried}, none would separate them.']
        return [
            *said,
            f'Of {tried}, none would decide. The best one separates them by {plain(best.separation, 2)} standard '
            f'deviations; {SEPARATION.separable:g} are needed. It is: {_closed(best.sentence)}',
        ]
    said.append(
        f'Of {tried}, this one separates them best. If the first explanation is right, it rules out '
        f'{ruled_out(best, diagnosis)} by at least {plain(best.separation, 2)} standard deviations.'
    )
    good = [
        f'{m.sentence.rstrip(".")} ({plain(m.separation, 2)}: {ruled_out(m, diagnosis)})' for m in others if m.decides
    ]
    return [*said, f'Next best: {"; ".join(good[: SENTENCES.further])}.'] if good else said


def ruled_out(measurement: NextMeasurement, diagnosis: Diagnosis) -> str:
    """Return which rivals a measurement would rule out, in words."""
    rivals = diagnosis.alternatives
    if measurement.decides == len(rivals):
        return {1: 'the rival', 2: 'both rivals'}.get(len(rivals), f'all {len(rivals)} rivals')
    return ', '.join(explanation_title(rivals[i]) for i in sorted(measurement.ruled_out)) or 'none'


def _count(n: int, noun: str) -> str:
    return f'{n} {noun}' + ('' if n == 1 else 's')


def _closed(sentence: str) -> str:
    return sentence if sentence.endswith(('.', '!', '?')) else f'{sentence}.'
