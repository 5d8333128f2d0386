"""Infineon's radar SDK: a NumPy array beside a JSON file with the device's settings."""

import dataclasses
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from drfmcw_physics.settings import ConfigurationError

from .base import Format, Source
from .numpy_arrays import NumpyFormat, NumpyOptions

_NEEDED = ('start_frequency_Hz', 'end_frequency_Hz', 'sample_rate_Hz', 'num_samples_per_chirp')

_SIZES = {'sample': 'num_samples_per_chirp', 'chirp': 'num_chirps_per_frame'}


@dataclasses.dataclass(frozen=True)
class InfineonOptions:
    """The JSON file states everything."""


def _flat(content: Any) -> dict[str, Any]:
    """Return all simple values of nested objects by their keys; the SDK's versions nest them differently."""
    found: dict[str, Any] = {}
    if isinstance(content, dict):
        for key, value in content.items():
            if isinstance(value, dict | list):
                found |= _flat(value) | ({key: value} if isinstance(value, list) else {})
            else:
                found[key] = value
    elif isinstance(content, list):
        for item in content:
            found |= _flat(item)
    return found


class InfineonFormat(Format):
    """Give both files: the arrays, mapped, and the JSON file whose settings count for all of them."""

    name = 'infineon'
    title = 'Infineon `.npy` with `.json`'
    suffixes = ('.json', '.npy')
    options = InfineonOptions

    @classmethod
    def takes(cls, paths: Sequence[Path]) -> bool:
        """Return True where a .json file stands among .npy files."""
        return super().takes(paths) and any(p.suffix.lower() == '.json' for p in paths)

    def facts(self, paths: Sequence[Path]) -> dict[str, dict[str, Any]]:
        """Return the sweep, the timing and the coding of the ADC."""
        stated = self._stated(paths)
        start, end = float(stated['start_frequency_Hz']), float(stated['end_frequency_Hz'])
        radar = {
            'start_frequency': start,
            'bandwidth': abs(end - start),
            'ramp': 'up' if end > start else 'down',
            'ramp_duration': stated['num_samples_per_chirp'] / float(stated['sample_rate_Hz']),
            'sample_rate': float(stated['sample_rate_Hz']),
        }
        for ours, theirs in (('repetition_time', 'chirp_repetition_time_s'), ('frame_time', 'frame_repetition_time_s')):
            if theirs in stated:
                radar[ours] = float(stated[theirs])
        return {
            'radar': radar,
            'samples': {'bits': 12, 'coding': 'offset_binary'},
            'layout': {'axes': ['frame', 'receiver', 'chirp', 'sample']},
        }

    def sizes(self, paths: Sequence[Path]) -> dict[str, int]:
        """Return samples, chirps of a frame and receivers, as far as the JSON file states them."""
        stated = self._stated(paths)
        sizes = {axis: stated[key] for axis, key in _SIZES.items() if isinstance(stated.get(key), int)}
        if isinstance(antennas := stated.get('rx_antennas'), list):
            sizes['receiver'] = len(antennas)
        return sizes

    @staticmethod
    def _stated(paths: Sequence[Path]) -> dict[str, Any]:
        """Return what the JSON file states.

        Raises:
            ConfigurationError: not one such file, not readable, or a key is missing.
        """
        own = [p for p in paths if p.suffix.lower() == '.json']
        if len(own) != 1:
            raise ConfigurationError(f'{paths[0]}: this format needs one .json file, not {len(own)}')
        try:
            stated = _flat(json.loads(own[0].read_text(encoding='utf-8')))
        except OSError as error:
            raise ConfigurationError(f'{own[0]}: {error.strerror}') from None
        except ValueError as error:
            raise ConfigurationError(f'{own[0]}: no JSON ({error})') from None
        for key in _NEEDED:
            if key not in stated:
                raise ConfigurationError(f"{own[0]}: key '{key}' is missing")
        return stated

    def sources(self, paths: Sequence[Path]) -> Iterator[Source]:
        """Yield each array."""
        arrays = [p for p in paths if p.suffix.lower() == '.npy']
        if not arrays:
            raise ConfigurationError(f'{paths[0]}: no .npy file is given beside it')
        yield from NumpyFormat(NumpyOptions()).sources(arrays)
