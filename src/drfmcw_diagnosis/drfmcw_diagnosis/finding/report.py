"""A diagnosis as one self-contained HTML page: no network, no scripts, pictures inside."""

import base64
import dataclasses
import functools
import math
import re
import shlex
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import yaml
from markupsafe import Markup, escape

from drfmcw_ros.commands.pages import templates
from drfmcw_ros.work.processes import Workers

from . import plots, quantities, repeating, wording
from .limits import PAGE, SEPARATION
from .result import BeforeAfter, Diagnosis, Explanation, FoundEffect, Separability, Series

_TEMPLATES = templates('drfmcw_diagnosis.finding')


@dataclasses.dataclass(frozen=True)
class Panel:
    """A picture with its title and note."""

    title: str
    note: str
    image: str  # data URI


@dataclasses.dataclass(frozen=True)
class Tile:
    """A figure at the top of the page."""

    name: str
    value: str
    note: str


@dataclasses.dataclass(frozen=True)
class Ranked:
    """One explanation in the ranking."""

    title: str
    sizes: tuple[str, ...]  # each effect's parameters
    gain: str
    odds: str  # against the best
    width: float  # of its bar [%]
    chosen: bool


@dataclasses.dataclass(frozen=True)
class Deciding:
    """One hypothetical measurement in the list of those that may decide between explanations."""

    sentence: str
    separation: str
    width: float  # of its bar [%]
    ruled_out: str
    decides: bool


@dataclasses.dataclass(frozen=True)
class Cell:
    """One distance of the separability matrix."""

    text: str
    kind: str  # 'self', 'near', 'far' or ''


def render_html(diagnosis: Diagnosis, configuration: str = '', jobs: int = 1) -> str:
    """Return the report.

    Args:
        diagnosis: what was found.
        configuration: text of the refined simulator configuration, shown folded where given.
        jobs: processes that draw its pictures.
    """
    explained = diagnosis.explanation is not None
    effects = diagnosis.explanation.effects if diagnosis.explanation else ()
    ranges = _range_series(diagnosis.series)
    others = sorted((s for s in diagnosis.series if s is not ranges), key=lambda s: -_excess(s))
    chosen, left_out = others[: PAGE.most], others[PAGE.most :]
    learnt = sorted(diagnosis.learnt, key=lambda s: -_excess(s))[: PAGE.most]

    def map_drawn() -> str | None:
        shown = diagnosis.misfit_map
        return _uri(plots.misfit_map(shown, explained)) if shown is not None else None

    drawing: list[Callable[[], Any]] = [
        map_drawn,
        lambda: _uri(plots.held_out(diagnosis.fit)) if explained else None,
        lambda: ranges and _panel(ranges, diagnosis),
        *(functools.partial(_panel, s, diagnosis) for s in chosen),
        *(functools.partial(_learnt_panel, s) for s in learnt),
    ]
    misfit_map, held_out, range_panel, *rest = Workers(jobs).map(lambda draw: draw(), drawing)
    panels, learnt_panels = rest[: len(chosen)], rest[len(chosen) :]
    shown = min(PAGE.unfolded, max(PAGE.least, sum(map(_is_informative, others))))
    return _TEMPLATES.get_template('report.html').render(
        d=diagnosis,
        w=wording,
        q=quantities,
        headline=wording.headline(diagnosis),
        paragraphs=wording.paragraphs(diagnosis),
        tiles=_tiles(diagnosis),
        explained=explained,
        effects=[(e, wording.effect_words(e)) for e in effects],
        misfit_map=misfit_map,
        panels=panels[:shown],
        folded=panels[shown:],
        left_out=len(left_out),
        ranges=range_panel,
        learnt=learnt_panels,
        measured=diagnosis.remainder and diagnosis.remainder.measured,
        r=repeating,
        ranking=_ranking(diagnosis),
        deciding=_deciding(diagnosis),
        threshold=100.0 * SEPARATION.separable / SEPARATION.full_bar,
        separability=diagnosis.separability and _cells(diagnosis.separability),
        separable=SEPARATION.separable,
        held_out=held_out,
        locations=[
            (x, 100.0 * min(max(x.share, 0.0), 1.0) if math.isfinite(x.share) else 0.0)
            for x in sorted(diagnosis.locations, key=lambda x: -x.share)
        ],
        command=diagnosis.command or f'./drfmcw diagnose {shlex.quote(diagnosis.recording)}',
        simulate=diagnosis.refined_config and f'./drfmcw simulate {shlex.quote(diagnosis.refined_config)} --out again',
        entries=_entries(effects) if effects else '',
        configuration=configuration,
        keep=_keep_together,
    )


def _uri(png: bytes) -> str:
    return 'data:image/png;base64,' + base64.b64encode(png).decode()


def _keep_together(text: str) -> Markup:
    """Return the text escaped, with no line end after a number or a ±."""
    return Markup(re.sub(r'(?<=[\d±]) (?=\S)', '\N{NO-BREAK SPACE}', str(escape(text))))


def _excess(series: Series) -> float:
    """Return by how much the sum of squares exceeds that of noise."""
    squares = _squares(series, series.residual)
    return float(np.sum(squares - 1.0)) if len(squares) else -math.inf


def _is_informative(series: Series) -> bool:
    """Return whether a series holds more than noise, or the explanation adds something to it."""
    n = len(_squares(series, series.residual))
    return bool(_excess(series) > 3.0 * math.sqrt(2.0 * n) or np.any(np.abs(series.curve) > 0.5 * series.std))


def _squares(series: Series, residual: np.ndarray) -> np.ndarray:
    known = np.isfinite(residual) & (series.std > 0.0)
    return (residual[known] / series.std[known]) ** 2


def _range_series(series: Sequence[Series]) -> Series | None:
    ranges = [s for s in series if s.level == 'range']
    order = ('range', 'time')
    return min(ranges, key=lambda s: order.index(s.axis) if s.axis in order else len(order), default=None)


def _panel(series: Series, diagnosis: Diagnosis) -> Panel:
    explained = diagnosis.explanation is not None
    squares = _squares(series, series.residual)
    note = ''
    if len(squares):
        note = f'misfit {quantities.misfit(float(squares.mean()))}'
        if explained:
            after = _squares(series, series.residual - series.curve)
            note += f' → {quantities.misfit(float(after.mean()))}'
    image = _uri(plots.series_panels(series, diagnosis.locations, explained))
    return Panel(quantities.capital(series.label), note, image)


def _learnt_panel(series: Series) -> Panel:
    """Return what the effects leave, with what was learnt of it."""
    squares, after = _squares(series, series.residual), _squares(series, series.residual - series.curve)
    note = ''
    if len(squares):
        note = f'misfit {quantities.misfit(float(squares.mean()))} → {quantities.misfit(float(after.mean()))}'
    return Panel(quantities.capital(series.label), note, _uri(plots.series_panels(series, (), True, plots.LEARNT)))


def _tiles(diagnosis: Diagnosis) -> list[Tile]:
    fit, explained = diagnosis.fit, diagnosis.explanation is not None

    def both(figure: BeforeAfter, sign: bool = True) -> str:
        before, after = wording.millimetres(figure.before, figure.after, sign=sign)
        return f'{before.removesuffix(" mm")} → {after}' if explained else before

    tiles = []
    measured = diagnosis.remainder.measured if diagnosis.remainder else None
    if math.isfinite(fit.held_out.before):
        after = f' → {quantities.misfit(fit.held_out.after)}' if explained else ''
        value = quantities.misfit(fit.held_out.before) + after
        tiles.append(Tile('misfit on held-out sweeps', value, '1 for a correct model'))
    if measured is not None and measured.curves:
        shown = (measured.held_out or measured.fitted).after
        tiles.append(Tile('misfit with the measured remainder', quantities.misfit(shown), 'measured, not physics'))
    if fit.range_bias is not None:
        tiles.append(Tile('mean range error', both(fit.range_bias), 'against the reference'))
    if fit.range_std is not None:
        tiles.append(
            Tile('standard deviation of the range', both(fit.range_std, sign=False), "including the reference's own")
        )
    tiles.append(
        Tile(
            'a mismatch this large by chance',
            wording.chance(diagnosis.significance).removesuffix(' recordings'),
            'recordings',
        )
    )
    return tiles


def _ranking(diagnosis: Diagnosis) -> list[Ranked]:
    if diagnosis.explanation is None:
        rows = list(diagnosis.alternatives)
    else:
        rows = [diagnosis.explanation, *diagnosis.alternatives]
    if not rows:
        return []
    rows.append(Explanation((), 0.0))
    best = max(r.log_evidence_gain for r in rows)
    return [
        Ranked(
            wording.explanation_title(r),
            tuple(', '.join(f'{p.name} {p.size}' for p in wording.effect_words(e).parameters) for e in r.effects),
            quantities.plain(r.log_evidence_gain, 3),
            'best' if r.log_evidence_gain == best else f'{wording.odds(best - r.log_evidence_gain)} probable',
            100.0 * max(0.0, r.log_evidence_gain) / best if best > 0.0 else 0.0,
            r is diagnosis.explanation,
        )
        for r in rows
    ]


def _deciding(diagnosis: Diagnosis) -> list[Deciding]:
    return [
        Deciding(
            m.sentence,
            quantities.plain(m.separation, 2),
            100.0 * min(m.separation / SEPARATION.full_bar, 1.0),
            quantities.capital(wording.ruled_out(m, diagnosis)),
            m.decides > 0,
        )
        for m in diagnosis.measurements
        if m.separation >= SEPARATION.informative
    ]


def _cells(separability: Separability) -> list[tuple[str, list[Cell]]]:
    rows = []
    for i, name in enumerate(separability.names):
        cells = []
        for j, distance in enumerate(map(float, separability.distance[i])):
            if i == j:
                cells.append(Cell('–', 'self'))
            elif math.isnan(distance):
                cells.append(Cell('', ''))
            else:
                text = '∞' if math.isinf(distance) else quantities.plain(distance, 2)
                cells.append(Cell(text, 'near' if distance < SEPARATION.separable else 'far'))
        rows.append((name, cells))
    return rows


def _entries(effects: Sequence[FoundEffect]) -> str:
    """Return the lines of a scenario that switch the effects on."""
    entries = []
    for found in effects:
        entry: dict = {'effect': found.effect} | ({'station': found.station} if found.station else {})
        for name, estimate in found.parameters.items():
            base = wording.parameter_name(name)
            value = _digits(estimate.value, estimate.std)
            if base == name:
                entry[name] = value
            else:
                entry.setdefault(base, []).append(value)
        entries.append(entry)
    return yaml.safe_dump({'effects': entries}, sort_keys=False, default_flow_style=None, width=100)


def _digits(value: float, std: float) -> float:
    """Return the value to a thousandth of its standard deviation."""
    if not (math.isfinite(std) and std > 0.0):
        return float(value)
    return float(f'{round(value, 3 - math.floor(math.log10(std))):.12g}')
