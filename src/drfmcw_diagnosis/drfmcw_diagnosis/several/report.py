"""Several recordings as JSON, as a table in the terminal, and as one page."""

import base64
import dataclasses
import io
import math
import os
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from rich.console import Group
from rich.table import Table
from rich.text import Text

from drfmcw_ros.commands.pages import templates
from drfmcw_sim.effects import Effect

from ..finding import quantities, wording
from ..finding.result import Diagnosis, Estimate, FoundEffect, effect_object, known
from ..finding.summary import COLORS
from .joint import Elsewhere, Joint, Shared
from .limits import JOINT
from .ramps import OneShape
from .running import Outcome

_TEMPLATES = templates('drfmcw_diagnosis.several')
_DATA, _COMBINED = '#2f4b66', '#c8374a'


def as_object(outcomes: Sequence[Outcome], joint: Joint, names: Mapping[str, str]) -> dict[str, Any]:
    """Return a JSON-ready object.

    Args:
        outcomes: of the recordings.
        joint: what they say together.
        names: short name of each recording, by path.
    """
    recordings = [
        {'recording': o.path, 'name': names[o.path], 'error': o.error or None}
        | ({'finding': o.diagnosis.as_object()} if o.diagnosis else {'finding': None})
        for o in outcomes
    ]
    return {
        'recordings': recordings,
        'shared': [_shared_object(s) for s in joint.shared],
        'alone': {path: [effect_object(f) for f in found] for path, found in joint.alone.items()},
        'ramps': [_ramp_object(o.path, o.shape) for o in outcomes if o.shape],
    }


def _ramp_object(path: str, shape: OneShape) -> dict[str, Any]:
    numbers = {
        name: known(value) if isinstance(value, float) else value
        for name, value in dataclasses.asdict(shape).items()
        if name != 'recordings'
    }
    return {'recording': path, 'shares_with': [p for p in shape.recordings if p != path]} | numbers


def _shared_object(shared: Shared) -> dict[str, Any]:
    return {
        'effect': shared.effect,
        'station': shared.station,
        'recordings': list(shared.recordings),
        'same_hardware': shared.same_hardware,
        'parameters': {
            name: {'value': known(e.value), 'std': known(e.std), 'unit': e.unit}
            for name, e in shared.parameters.items()
        },
        'chi_square': known(shared.chi_square),
        'degrees_of_freedom': shared.freedom,
        'probability': known(shared.probability),
        'agrees': shared.agrees if shared.same_hardware else None,
        'contradicting': list(shared.contradicting),
        'elsewhere': [
            {'recording': x.recording, 'scale': known(x.scale), 'std': known(x.std), 'says': x.words.replace(' ', '_')}
            for x in shared.elsewhere
        ],
    }


def title(effect: str, station: str | None) -> str:
    """Return name and station of an effect."""
    return wording.effect_title(FoundEffect(effect, station, {}, 0.0, 1.0))


def sizes(parameters: Mapping[str, Estimate]) -> str:
    """Return parameters with their sizes, joined."""
    return ', '.join(
        f'{name.replace("_", " ")} {quantities.quantity(e.value, e.std, e.unit)}' for name, e in parameters.items()
    )


def agreement(shared: Shared, names: Mapping[str, str]) -> str:
    """Return in sentences whether the recordings agree."""
    if not shared.same_hardware:
        if Effect.registry[shared.effect].evidence == 'rate':
            return (
                'Its values go with the time in each ramp; recordings of one oscillator share the shape over frequency.'
            )
        return 'It belongs to the path or to the band of each recording, so the sizes are not combined.'
    said = []
    if shared.freedom:
        chance = wording.chance(shared.probability).removesuffix(' recordings')
        alike = 'agree' if shared.probability >= JOINT.disagreement else 'DISAGREE'
        said.append(
            f'The recordings in which it was found {alike}: chi-square {quantities.plain(shared.chi_square)} for '
            f'{shared.freedom} degrees of freedom, by chance in {chance}.'
        )
    if shared.contradicting:
        one = len(shared.contradicting) == 1
        who = ', '.join(names[r] for r in shared.contradicting)
        said.append(f'{who} contradict{"s" if one else ""} them.')
    return ' '.join(said) or 'No other recording can test it.'


def elsewhere_words(x: Elsewhere, names: Mapping[str, str]) -> str:
    """Return what a recording says of an effect that was not found in it."""
    size = f'{quantities.plain(x.scale, 2)} ± {quantities.plain(x.std, 2)} of the size'
    return f'{names[x.recording]}: {x.words} ({size})'


def ramp_groups(outcomes: Sequence[Outcome], names: Mapping[str, str]) -> list[tuple[str, list[str]]]:
    """Return of each oscillator with a bent ramp a title, and sentences; arguments as `as_object`."""
    shapes = {o.path: o.shape for o in outcomes if o.shape}
    groups = dict.fromkeys(tuple(p for p in s.recordings if p in shapes) for s in shapes.values())
    said = []
    for group in groups:
        own = [shapes[p] for p in group]
        low, high = min(s.band[0] for s in own), max(s.band[1] for s in own)
        rate = (
            f'differs from its mean by {100.0 * max(s.rate for s in own):.1f} % rms, {low / 1e9:.3f} to '
            f'{high / 1e9:.3f} GHz'
        )
        if len(group) < 2:
            said.append(
                (
                    f'Only in {names[group[0]]}: shape of the ramp at {own[0].station}',
                    [f'Its rate {rate}; no other recording has this shape.'],
                )
            )
            continue
        lines = [
            f'Its rate {rate}: one shape over frequency describes all of them, as that of one oscillator. Their delays '
            'are on one scale, which no length has set.'
        ]
        lines += [_shape_words(shapes[p], names[p]) for p in group]
        said.append((f'Shared: shape of the ramp at {own[0].station} ({", ".join(names[p] for p in group)})', lines))
    return said


def _shape_words(s: OneShape, name: str) -> str:
    off = 100.0 * (s.predicted_delay / s.delay - 1.0)
    return (
        f'{name}: delay {quantities.quantity(s.delay, s.delay_std, "s")}. What was held out: {s.straight:.1f} LSB rms '
        f'beside a straight ramp, {s.own:.1f} beside a shape of its own, {s.shared:.1f} beside the one shape, '
        f'{s.predicted:.1f} beside the shape that the others alone teach, by which its delay is {off:+.2f} % off; '
        f'noise {s.noise:.1f}.'
    )


def _misfits(diagnosis: Diagnosis) -> str:
    fit = diagnosis.fit.held_out
    if not math.isfinite(fit.before):
        fit = diagnosis.fit.fitted
    if diagnosis.explanation is None:
        return quantities.misfit(fit.before)
    return f'{quantities.misfit(fit.before)} → {quantities.misfit(fit.after)}'


def _effects(diagnosis: Diagnosis) -> list[str]:
    found = diagnosis.explanation.effects if diagnosis.explanation else ()
    return [quantities.capital(wording.effect_title(e)) for e in found]


def terminal(outcomes: Sequence[Outcome], joint: Joint, names: Mapping[str, str]) -> Group:
    """Return what `diagnose` prints of several recordings; arguments as `as_object`."""
    table = Table(title=None, header_style='bold')
    table.add_column('recording', no_wrap=True)
    table.add_column('verdict', no_wrap=True)
    table.add_column('effects', overflow='fold')
    table.add_column('held-out misfit', justify='right', no_wrap=True)
    for outcome in outcomes:
        d = outcome.diagnosis
        if d is None:
            table.add_row(names[outcome.path], Text('not read', 'red'), Text('–'), Text('–'))
            continue
        effects = '\n'.join(_effects(d)) or '–'
        table.add_row(names[outcome.path], Text(d.verdict, COLORS[d.verdict]), Text(effects), Text(_misfits(d)))
    lines: list[Text] = []
    for head, said in ramp_groups(outcomes, names):
        lines += [Text(f'\n{head}', 'bold'), *(Text(f'  {sentence}') for sentence in said)]
    for shared in joint.shared:
        where = ', '.join(names[r] for r in shared.recordings)
        lines.append(Text(f'\nShared: {title(shared.effect, shared.station)} ({where})', 'bold'))
        if shared.parameters:
            lines.append(Text(f'  {quantities.capital(sizes(shared.parameters))}'))
        lines.append(Text(f'  {agreement(shared, names)}'))
        lines += [Text(f'  {elsewhere_words(x, names)}') for x in shared.elsewhere]
    for path, found in joint.alone.items():
        if found:
            lines.append(Text(f'\nOnly in {names[path]}', 'bold'))
            lines += [Text(f'  {quantities.capital(wording.effect_title(f))}: {sizes(f.parameters)}') for f in found]
    return Group(table, *lines)


def render_html(
    outcomes: Sequence[Outcome], joint: Joint, names: Mapping[str, str], reports: Mapping[str, str], command: str
) -> str:
    """Return the page.

    Args:
        outcomes: of the recordings.
        joint: what they say together.
        names: short name of each recording, by path.
        reports: path of each recording's report, relative to the page, by path of the recording.
        command: that was given.
    """
    rows = [(o, names[o.path], reports.get(o.path)) for o in outcomes]
    read = [o for o in outcomes if o.diagnosis]
    return _TEMPLATES.get_template('several.html').render(
        w=wording,
        rows=rows,
        read=len(read),
        effects=_effects,
        misfits=_misfits,
        shared=[
            (
                s,
                quantities.capital(title(s.effect, s.station)),
                agreement(s, names),
                _forest(s, names) if s.parameters else None,
            )
            for s in joint.shared
        ],
        ramps=ramp_groups(outcomes, names),
        elsewhere=elsewhere_words,
        names=names,
        alone=[
            (names[path], [(quantities.capital(wording.effect_title(f)), sizes(f.parameters)) for f in found])
            for path, found in joint.alone.items()
            if found
        ],
        descriptions={s.effect: ' '.join(str(Effect.registry[s.effect].__doc__).split()) for s in joint.shared},
        size=quantities.quantity,
        command=command,
    )


def _forest(shared: Shared, names: Mapping[str, str]) -> str:
    """Return each recording's estimates of a shared effect beside the combined ones, as a data URI."""
    parameters = list(shared.parameters.items())[:4]
    count = len(shared.found)
    style: Any = {'font.size': 10, 'axes.spines.top': False, 'axes.spines.right': False}
    with matplotlib.rc_context(style):
        figure = Figure(figsize=(11.0, 1.3 + 0.34 * count), dpi=150, layout='constrained')
        axes = figure.subplots(1, len(parameters), sharey=True, squeeze=False)[0]
        for axis, (name, combined) in zip(axes, parameters, strict=True):
            axis.axvspan(combined.value - combined.std, combined.value + combined.std, color=_COMBINED, alpha=0.2)
            axis.axvline(combined.value, color=_COMBINED, linewidth=1.2)
            for number, found in enumerate(shared.found):
                own = found.parameters[name]
                axis.errorbar(own.value, number, xerr=own.std, fmt='o', color=_DATA, markersize=5)
            axis.set_yticks(range(count), [names[r] for r in shared.recordings], parse_math=False)
            axis.set_ylim(count - 0.5, -0.5)
            axis.ticklabel_format(axis='x', useOffset=False, style='plain')
            axis.locator_params(axis='x', nbins=4)
            unit = combined.unit if combined.unit != '1' else ''
            axis.set_xlabel(name.replace('_', ' ') + (f' [{unit}]' if unit else ''))
        image = io.BytesIO()
        FigureCanvasAgg(figure).print_png(image, metadata={'Software': None})
    return 'data:image/png;base64,' + base64.b64encode(image.getvalue()).decode()


def short_names(paths: Sequence[str]) -> dict[str, str]:
    """Return a distinct short name of each recording: its directory's, numbered where two have the same."""
    found: dict[str, str] = {}
    for path in dict.fromkeys(paths):
        base = os.path.basename(os.path.abspath(path)) or 'recording'
        name, number = base, 2
        while name in found.values():
            name, number = f'{base}_{number}', number + 1
        found[path] = name
    return found
