"""`docs/real_recordings.md`: what came out, in figures of our own."""

from collections.abc import Sequence

from drfmcw_diagnosis.finding.quantities import misfit
from drfmcw_diagnosis.finding.result import Diagnosis

from .running import Carried, Control, Found, Results, Setting

_RIGHT = 0.9  # share of the trials that must be right
_LARGE = 12.0  # d from which on they count
_IMPORTS = [
    'Six are at hand as recordings. The others are imported from the files beside them, with these settings:',
    '',
    '```yaml',
    '# bgt60.yaml',
    'radar: {start_frequency: 58e9, bandwidth: 5.5e9}',
    'layout: {axes: [frame, receiver, chirp, sample], receiver: 0}',
    'samples: {bits: 12, coding: offset_binary}',
    '# coffeecan.yaml',
    'radar: {start_frequency: 2.408e9, bandwidth: 87e6, ramp_duration: 20e-3}',
    'layout: {sample_count: 882}',
    '```',
    '',
    '```',
    './drfmcw import raw/bgt60_radar.npy --settings bgt60.yaml --out more/bgt60',
    './drfmcw import raw/coffeecan_single_target.wav --settings coffeecan.yaml --out more/coffeecan',
    '```',
]


def page(
    command: str,
    results: Results,
) -> str:
    """Return the page as Markdown; `command` made it."""
    lines = [
        '# Recordings of real radars',
        '',
        f'`{command}` wrote this page. The recordings are not part of the repository; only figures computed here are '
        'shown. Nobody knows the truth behind them, so three things are shown: what is found in each, whether a ramp '
        'learnt on one recording describes another one, and whether effects that were added to the real samples at a '
        'known size come out.',
        '',
        '## What was found',
        '',
        'Misfit per degree of freedom on what was held out, 1 where the model is right. "Left" is the share of the '
        'excess misfit that the effects do not explain.',
        '',
        '| recording | sweeps x samples | verdict | effects | misfit before | after | left | time |',
        '|---|---|---|---|---|---|---|---|',
    ]
    lines += map(_row, results.found)
    for x in results.found:
        said = _sentences(x.diagnosis)
        if said:
            lines += ['', f'**{x.name}**: ' + ' '.join(said)]
    lines += ['', '## Ramps learnt on one recording, tried on another one', '', *_shapes(results.carried)]
    lines += [*_wrong(results.settings), '', '## Effects added to real samples', '', *_tries(results)]
    lines += ['', '## Nothing added', '', *_controls(results.controls)]
    lines += ['', '## How the recordings were made', '', *_IMPORTS]
    lines += [
        '',
        '## What cannot be found this way',
        '',
        'A wrong ramp rate, sampling rate or start frequency of a station that hears itself changes the length that '
        'comes out, and nothing else in its samples. It shows only against a known length, a second station, or a '
        'second setting of the same radar.',
        '',
    ]
    return '\n'.join(lines)


def _row(x: Found) -> str:
    shape = f'{x.sweeps} x {x.samples}{" I/Q" if x.iq else ""}'
    if x.diagnosis is None:
        return f'| {x.name} | {shape} | refused: {x.refusal} | | | | | {x.seconds:.0f} s |'
    d = x.diagnosis
    fit = d.fit.held_out if d.fit.held_out.before == d.fit.held_out.before else d.fit.fitted
    left = '' if d.remainder is None else f'{100.0 * d.remainder.share:.1f} %'
    return (
        f'| {x.name} | {shape} | {d.verdict} | {_effects(d)} | {misfit(fit.before)} | {misfit(fit.after)} | {left} '
        f'| {x.seconds:.0f} s |'
    )


def _effects(d: Diagnosis) -> str:
    if d.explanation is None:
        return 'none'
    texts = []
    for effect in d.explanation.effects:
        sizes = [f'{k} {e.value:.4g} {e.unit}'.strip() for k, e in effect.parameters.items() if '[' not in k]
        texts.append(f'`{effect.effect}`' + (f' ({", ".join(sizes)})' if sizes else ''))
    return '; '.join(texts)


def _sentences(d: Diagnosis | None) -> list[str]:
    """Return the sentences that say more than the table."""
    wanted = (
        'rate differs',
        'Delay of the line',
        'constant that varies',
        'repeats with the ramp',
        'strongest line that moves',
        'lines before the limit',
        'strongest of',
    )
    return [] if d is None else [s for s in d.sentences if any(w in s for w in wanted)]


def _shapes(carried: Sequence[Carried]) -> list[str]:
    if not carried:
        return ['No two recordings of one radar with a bent ramp were given.']
    lines = [
        'Only delay and phase are fitted to the other recording. The first columns hold delays on the scale of the one '
        'that the shape was learnt on.',
        '',
        '| learnt on | tried on | delay there [ns] | delay here [ns] | difference | each by itself | held-out misfit '
        '[LSB] | by its own shape |',
        '|---|---|---|---|---|---|---|---|',
    ]
    for c in carried:
        lines.append(
            f'| {c.learnt} | {c.tried} | {1e9 * c.known:.3f} | {1e9 * c.delay:.3f} | '
            f'{100.0 * (c.delay / c.known - 1.0):+.3f} % | {100.0 * (c.alone / c.known - 1.0):+.2f} % | '
            f'{c.held_out:.1f} | {c.own:.1f} |'
        )
    return lines


def _wrong(settings: Sequence[Setting]) -> list[str]:
    if not settings:
        return []
    lines = [
        '',
        'A wrong setting of one recording shows beside another one of the same radar and cable: the delays disagree by '
        'more than 0.3 %, or the shape no longer fits. d is the root of the rise of chi-square on what was held out.',
        '',
        '| learnt on | tried on, with a wrong setting | d | difference of the delays | misfit over that with the right '
        'setting | seen |',
        '|---|---|---|---|---|---|',
    ]
    return lines + [
        f'| {s.learnt} | {s.tried}: {s.words} | {s.size:.0f} | {100.0 * s.difference:+.2f} % | {s.misfit:.2f} | '
        f'{"yes" if s.seen else "no"} |'
        for s in settings
    ]


def _tries(results: Results) -> list[str]:
    trials = [t for t in results.trials if t.size >= _LARGE]
    right = sum(t.outcome == 'right' for t in trials)
    invented = sum(t.outcome == 'invented' for t in results.trials)
    seen = sum(x for _, x in results.exchanged)
    lines = [
        'The first 96 sweeps of each are taken. '
        'd is the root sum of squares of what was added, over the standard deviation of what the diagnosis of the '
        'unchanged recording leaves. Sizes of an imbalance are judged with what the receiver has of its own, as the '
        'unchanged samples show it; an echo of a radar that hears itself is one more line, and right where that line '
        'stands. Ripples and echoes are not tried beside bursts and bent ramps, where neither is searched for, nor '
        'anything in a receiver that limits.',
        '',
        f'{right} of {len(trials)} with d of {_LARGE:.0f} and more right ({100.0 * right / max(len(trials), 1):.0f} %, '
        f'aim {100.0 * _RIGHT:.0f} %), {invented} with a further effect invented. Swapped I and Q were seen in {seen} '
        f'of {len(results.exchanged)} recordings.',
        '',
        '| recording | added | d | outcome | found |',
        '|---|---|---|---|---|',
    ]
    return lines + [
        f'| {t.recording} | {t.effect}: {t.words} | {t.size:.0f} | {t.outcome} | {t.found} |' for t in results.trials
    ]


def _controls(controls: Sequence[Control]) -> list[str]:
    if not controls:
        return ['No recording has sweeps enough to be divided.']
    invented = [c for c in controls if c.invented]
    lines = [
        f'Halves of the recordings as they are: in {len(invented)} of {len(controls)} an effect is named that the '
        'whole recording does not show, nor if what it shows is left out: behind a limit bursts are not searched for.',
        '',
        '| recording | sweeps | invented |',
        '|---|---|---|',
    ]
    return lines + [f'| {c.recording} | {c.words} | {", ".join(sorted(c.invented)) or "nothing"} |' for c in controls]
