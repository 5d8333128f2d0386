"""`docs/real_recordings.md`: what came out, in figures of our own."""

from collections.abc import Sequence

from drfmcw_diagnosis.finding.quantities import misfit
from drfmcw_diagnosis.finding.result import Diagnosis

from .running import Carried, Found, Setting, Trial

_RIGHT = 0.9  # share of the trials that must be right


def page(
    command: str,
    found: Sequence[Found],
    trials: Sequence[Trial],
    carried: Sequence[Carried],
    settings: Sequence[Setting],
    exchanged: Sequence[tuple[str, bool]],
) -> str:
    """Return the page as Markdown."""
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
    lines += map(_row, found)
    for x in found:
        said = _sentences(x.diagnosis)
        if said:
            lines += ['', f'**{x.name}**: ' + ' '.join(said)]
    lines += ['', '## Ramps learnt on one recording, tried on another one', '', *_shapes(carried), *_wrong(settings)]
    lines += ['', '## Effects added to real samples', '', *_tries(trials, exchanged)]
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
        'more than 0.3 %, or the shape no longer fits.',
        '',
        '| learnt on | tried on, with a wrong setting | difference of the delays | misfit over that with the right '
        'setting | seen |',
        '|---|---|---|---|---|',
    ]
    return lines + [
        f'| {s.learnt} | {s.tried}: {s.words} | {100.0 * s.difference:+.2f} % | {s.misfit:.2f} | '
        f'{"yes" if s.seen else "no"} |'
        for s in settings
    ]


def _tries(trials: Sequence[Trial], exchanged: Sequence[tuple[str, bool]]) -> list[str]:
    right = sum(t.outcome == 'right' for t in trials)
    invented = sum(t.outcome == 'invented' for t in trials)
    seen = sum(x for _, x in exchanged)
    lines = [
        'Sizes of an imbalance are judged with what the receiver has of its own, as the unchanged samples show it. '
        f'{right} of {len(trials)} right ({100.0 * right / max(len(trials), 1):.0f} %, aim {100.0 * _RIGHT:.0f} %), '
        f'{invented} with a further effect invented. Swapped I and Q were seen in {seen} of {len(exchanged)} '
        'recordings.',
        '',
        '| recording | added | outcome | found |',
        '|---|---|---|---|',
    ]
    return lines + [f'| {t.recording} | {t.effect}: {t.words} | {t.outcome} | {t.found} |' for t in trials]
