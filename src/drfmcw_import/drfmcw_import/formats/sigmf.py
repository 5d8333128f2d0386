"""SigMF: a .sigmf-meta file (JSON) beside a .sigmf-data file."""

import dataclasses
import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drfmcw_physics.settings import ConfigurationError

from .base import Format, Source
from .raw import mapped

_TYPE = re.compile(r'^([cr])([fiu])(8|16|32|64)(_le|_be)?$')


@dataclasses.dataclass(frozen=True)
class SigmfOptions:
    """SigMF files state everything themselves."""


def _metadata(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the objects `global` and the first of `captures` that belong to a SigMF file."""
    meta = path.with_suffix('.sigmf-meta')
    try:
        content = json.loads(meta.read_text(encoding='utf-8'))
        stated, captures = content['global'], content.get('captures') or [{}]
        return dict(stated), dict(captures[0])
    except OSError as error:
        raise ConfigurationError(f'{meta}: {error.strerror}') from None
    except (ValueError, KeyError, TypeError) as error:
        raise ConfigurationError(f'{meta}: no SigMF metadata ({error})') from None


def _dtype(path: Path, stated: dict[str, Any]) -> np.dtype[Any]:
    text = str(stated.get('core:datatype', ''))
    match = _TYPE.match(text)
    if match is None:
        raise ConfigurationError(f"{path}: core:datatype '{text}' is not known")
    domain, kind, bits, order = match.groups()
    number = np.dtype(f'{">" if order == "_be" else "<"}{kind}{int(bits) // 8}')
    return np.dtype([('i', number), ('q', number)]) if domain == 'c' else number


class SigmfFormat(Format):
    """The data file is mapped; type, byte order, rate and start time come from the metadata."""

    name = 'sigmf'
    title = 'SigMF `.sigmf-meta`, `.sigmf-data`'
    suffixes = ('.sigmf-meta', '.sigmf-data')
    options = SigmfOptions

    def facts(self, paths: Sequence[Path]) -> dict[str, dict[str, Any]]:
        """Return sampling rate, start time, and how numbers are coded."""
        stated, capture = _metadata(paths[0])
        radar = {}
        if 'core:sample_rate' in stated:
            radar['sample_rate'] = stated['core:sample_rate']
        if 'core:datetime' in capture:
            radar['start_time'] = str(capture['core:datetime'])
        facts = {'radar': radar}
        kind = _dtype(paths[0], stated)
        number = kind if kind.names is None else kind[0]
        if number.kind == 'u':
            facts['samples'] = {'bits': 8 * number.itemsize, 'coding': 'offset_binary'}
        return facts

    def sources(self, paths: Sequence[Path]) -> Iterator[Source]:
        """Yield each file's numbers, (samples,) or (samples, channels); .sigmf-meta and -data of one name are one."""
        for path in dict.fromkeys(p.with_suffix('.sigmf-data') for p in paths):
            stated, capture = _metadata(path)
            channels = int(stated.get('core:num_channels', 1))
            header = int(capture.get('core:header_bytes', 0))
            yield Source(mapped(path, _dtype(path, stated), header, channels if channels > 1 else 0), str(path))
