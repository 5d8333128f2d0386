"""TI's DCA1000 capture card: raw 16-bit numbers in the order of the LVDS lanes."""

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from drfmcw_physics.settings import ConfigurationError, parameter

from .base import Format, Source
from .raw import mapped


@dataclasses.dataclass(frozen=True)
class Dca1000Options:
    """Options of DCA1000 captures."""

    lanes: int = parameter(
        4,
        bounds=(2, 4),
        description='LVDS lanes: 4 for xWR12xx and xWR14xx (receivers alternate sample by sample), '
        '2 for xWR16xx, xWR18xx and xWR68xx (receiver after receiver, two I then two Q)',
    )
    receivers: int = parameter(4, bounds=(1, 4), description='receivers switched on')
    samples: int = parameter(256, bounds=(16, 65536), description='ADC samples of one chirp')
    chirps: int = parameter(0, bounds=(0, 65536), description='chirps of one frame and transmitter; 0: no frames')
    transmitters: int = parameter(1, bounds=(1, 4), description='transmitters that take turns from chirp to chirp')
    real: bool = parameter(False, description='real samples, not I and Q')

    def __post_init__(self) -> None:
        """Refuse lanes that no device has, and pairs of samples that do not come out even."""
        if self.lanes == 3:
            raise ConfigurationError('lanes = 3 is not 2 or 4')
        if self.lanes == 2 and self.samples % 2:
            raise ConfigurationError(f'samples = {self.samples} must be even with two lanes')


class Dca1000Format(Format):
    """TI's application report SWRA581, "Mmwave Radar Device ADC Raw Data Capture"; the file is mapped."""

    name = 'dca1000'
    title = 'TI DCA1000 `.bin`, by `format: dca1000`'
    options = Dca1000Options

    @classmethod
    def takes(cls, paths: Sequence[Path]) -> bool:
        """Return False: the name .bin does not distinguish it from other raw files."""
        return False

    def facts(self, paths: Sequence[Path]) -> dict[str, dict[str, Any]]:
        """Return axes and shape of the lanes' order."""
        o = self.chosen
        if o.lanes == 4:
            axes, shape = ['sample', 'iq', 'receiver'], [o.samples, 2, o.receivers]
            if o.real:
                axes, shape = ['sample', 'receiver'], [o.samples, o.receivers]
        else:
            axes, shape = ['receiver', 'sample', 'iq', 'sample'], [o.receivers, o.samples // 2, 2, 2]
            if o.real:
                axes, shape = ['receiver', 'sample'], [o.receivers, o.samples]
        if o.transmitters > 1:
            axes, shape = ['transmitter', *axes], [o.transmitters, *shape]
        if o.chirps:
            axes, shape = ['frame', 'chirp', *axes], [-1, o.chirps, *shape]
        else:
            axes, shape = ['chirp', *axes], [-1, *shape]
        return {'layout': {'axes': axes, 'shape': shape}, 'samples': {'bits': 16}}

    def sources(self, paths: Sequence[Path]) -> Iterator[Source]:
        """Yield each file's numbers."""
        for path in paths:
            yield Source(mapped(path, '<i2'), str(path))
