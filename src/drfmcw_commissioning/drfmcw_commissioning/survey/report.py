"""The acceptance report: one HTML page that needs nothing else and prints well, and the same as JSON."""

import base64
import dataclasses
import datetime
import hashlib
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from drfmcw_ros.bag.files import BagError
from drfmcw_ros.commands.pages import templates

from . import plots
from .evidence import Evidence, PairEvidence
from .findings import BinFinding, PairFinding, worst
from .requirements import Requirements
from .verdict import Result, Verdict, passes

_TEMPLATES = templates('drfmcw_commissioning.survey')
_STORAGE = '.mcap', '.db3', '.zstd', '.yaml'
_WORST = 5  # positions listed
_BLOCK = 1 << 20  # bytes read at once


@dataclasses.dataclass(frozen=True)
class Survey:
    """What a survey found."""

    path: str
    checksum: str  # SHA-256 of the recording's files
    requirements: Requirements
    source: str  # of the requirements
    evidence: Evidence
    findings: tuple[PairFinding, ...]
    verdicts: tuple[Verdict, ...]

    @property
    def passed(self) -> bool:
        """Return whether all requirements are met and shown."""
        return passes(self.verdicts)


def checksum(path: str) -> str:
    """Return the SHA-256 of a recording: of all its files in the order of their names.

    Raises:
        BagError: a file cannot be read.
    """
    root = Path(path)
    files = [root] if root.is_file() else sorted(file for file in root.iterdir() if file.suffix in _STORAGE)
    digest = hashlib.sha256()
    try:
        for file in files:
            digest.update(file.name.encode() + b'\0')
            with file.open('rb') as stream:
                while block := stream.read(_BLOCK):
                    digest.update(block)
    except OSError as error:
        raise BagError(f'{path}: {error.strerror or error}') from None
    return digest.hexdigest()


def as_object(survey: Survey) -> dict[str, Any]:
    """Return the survey ready for JSON; numbers that are not finite become null."""
    return _plain(
        {
            'recording': survey.path,
            'sha256': survey.checksum,
            'verdict': 'pass' if survey.passed else 'fail',
            'requirements': dataclasses.asdict(survey.requirements),
            'verdicts': [dataclasses.asdict(v) | {'result': v.result.value} for v in survey.verdicts],
            'pairs': [dataclasses.asdict(f) | {'availability': f.availability} for f in survey.findings],
            'dropped': survey.evidence.replay.dropped,
            'missing': survey.evidence.replay.missing,
        }
    )


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def headline(survey: Survey) -> str:
    """Return the verdict in one sentence."""
    failed = [v for v in survey.verdicts if v.result is Result.NOT_MET]
    unknown = [v for v in survey.verdicts if v.result is Result.NOT_SHOWN]
    if survey.passed:
        return f'The site meets all {len(survey.verdicts)} requirements'
    parts = [f'{len(failed)} not met'] if failed else []
    parts += [f'{len(unknown)} not shown by this recording'] if unknown else []
    return f'Of {len(survey.verdicts)} requirements {" and ".join(parts)}'


def render(survey: Survey) -> str:
    """Return the HTML page."""
    sections = [
        _section(pair, finding, survey.requirements)
        for pair, finding in zip(survey.evidence.pairs, survey.findings, strict=True)
    ]
    return _TEMPLATES.get_template('survey.html').render(
        name=Path(survey.path).resolve().name,
        survey=survey,
        headline=headline(survey),
        sections=sections,
        marks={Result.MET: 'met', Result.NOT_MET: 'failed', Result.NOT_SHOWN: 'unknown'},
        made=datetime.datetime.now().astimezone().strftime('%Y-%m-%d %H:%M %Z'),
        recorded=_recorded(survey.evidence.pairs),
    )


def _recorded(pairs: Sequence[PairEvidence]) -> str:
    first = min(int(pair.stamps[0]) for pair in pairs)
    last = max(int(pair.stamps[-1]) for pair in pairs)
    begin, end = (datetime.datetime.fromtimestamp(stamp * 1e-9, datetime.UTC) for stamp in (first, last))
    return f'{begin:%Y-%m-%d %H:%M} to {end:%Y-%m-%d %H:%M} UTC'


def _uri(png: bytes) -> str:
    return f'data:image/png;base64,{base64.b64encode(png).decode()}'


def _section(pair: PairEvidence, finding: PairFinding, requirements: Requirements) -> dict[str, Any]:
    """Return what the template shows of a pair."""
    suffers = any(b.usable < 1.0 or b.disturbed > 0.0 for b in finding.bins)
    return {
        'finding': finding,
        'worst': worst(finding, _WORST),
        'link': _uri(plots.link_plot(pair, finding)),
        'error': _uri(plots.error_plot(pair, finding, requirements)) if finding.compared else '',
        'quality': _uri(plots.quality_plot(finding)) if suffers else '',
        'conditions': _uri(plots.conditions_plot(pair)),
        'rows': [_row(b) for b in finding.bins],
        'stations': [station.name for station in pair.stations],
    }


def _number(value: float, digits: int = 1, factor: float = 1.0) -> str:
    return f'{factor * value:.{digits}f}' if math.isfinite(value) else '-'


def _row(b: BinFinding) -> dict[str, Any]:
    return {
        'distances': b.distances,
        'sweeps': b.sweeps,
        'usable': f'{100.0 * b.usable:.1f}',
        'bias': _number(b.bias, 1, 1e3),
        'std': _number(b.std, 1, 1e3) if math.isfinite(b.bias) else '-',
        'reported': _number(b.reported_std, 1, 1e3),
        'excess': ' / '.join(_number(value) for value in b.excess),
        'fading': _number(b.fading),
        'margin': _number(b.margin),
        'reasons': '; '.join(b.reasons),
    }
