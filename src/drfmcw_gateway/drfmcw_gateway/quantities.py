"""The one table of what a controller gets: OPC UA variables, Modbus registers and documentation follow from it."""

import dataclasses
import enum
import math
import struct
from collections.abc import Callable, Sequence

from .reading import NANOSECONDS, Controller, Quality, Reading

MAP_VERSION = 1
"""Of the register map. A later one adds registers and moves none."""
BLOCK = 100
"""Registers from one pair's block to the next; that of pair n (from 1) begins at n * BLOCK, the gateway's own at 0."""
HEARTBEAT_REGISTER = 0
"""Holding register that the controller writes."""
HEARTBEAT_INTERVAL = 0.1
"""Time in which the gateway's heartbeat advances by one [s]."""


class Kind(enum.Enum):
    """How a number lies in registers, high word first, high byte first: struct format and number of registers."""

    UINT16 = ('>H', 1)
    UINT32 = ('>I', 2)
    INT32 = ('>i', 2)
    FLOAT32 = ('>f', 2)

    @property
    def size(self) -> int:
        """Return the number of registers."""
        return self.value[1]

    def registers(self, number: float) -> tuple[int, ...]:
        """Return a number as registers; integers out of bounds wrap where unsigned and saturate where signed."""
        data = struct.pack(self.value[0], self._fitting(number))
        return struct.unpack(f'>{self.size}H', data)

    def _fitting(self, number: float) -> float:
        if self is Kind.FLOAT32:
            return math.copysign(math.inf, number) if abs(number) > _LARGEST_FLOAT else number
        if self is Kind.INT32:
            return NOT_A_NUMBER if math.isnan(number) else round(max(-_LARGEST, min(_LARGEST, number)))
        return int(number) % (1 << 16 * self.size)


_LARGEST_FLOAT = 3.4e38  # of a float32
_LARGEST = (1 << 31) - 1
NOT_A_NUMBER = -(1 << 31)
"""What an integer register pair holds where the number must not be used."""


@dataclasses.dataclass(frozen=True)
class Quantity:
    """One number about a pair."""

    name: str
    kind: Kind  # in registers
    unit: str
    description: str
    read: Callable[[Reading], float]
    measured: bool = False  # it carries the quality of the range as its OPC UA status
    registers_only: bool = False  # OPC UA has it anyway, or needs no integer form of it


def _age(reading: Reading) -> float:
    """Return the age in milliseconds that a register can hold."""
    age = reading.age if math.isfinite(reading.age) else math.inf
    return round(max(0.0, min(1e3 * age, 65535.0)))


def _stamp(reading: Reading) -> tuple[int, int]:
    return divmod(reading.estimate.stamp, NANOSECONDS) if reading.estimate else (0, 0)


def _scaled(name: str) -> Callable[[Reading], float]:
    return lambda reading: 1e4 * reading.value(name)


PAIR_QUANTITIES: tuple[Quantity, ...] = (
    Quantity('quality', Kind.UINT16, '', 'quality word: bits below', lambda r: int(r.quality)),
    Quantity('age', Kind.UINT16, 'ms', 'time since the sweep, 65535 without one or beyond', _age),
    Quantity(
        'counter', Kind.UINT32, '', 'ranges since the start of the gateway; unchanged: no new range',
        lambda r: r.counter,
    ),
    Quantity('range', Kind.FLOAT32, 'm', 'distance of the antennas', lambda r: r.value('range'), measured=True),
    Quantity('range_std', Kind.FLOAT32, 'm', 'its standard deviation', lambda r: r.value('range_std'), measured=True),
    Quantity(
        'protection_level', Kind.FLOAT32, 'm',
        'the error exceeds it with a probability of 1e-5 at most; infinite where nothing can be said',
        lambda r: r.value('protection_level'), measured=True,
    ),
    Quantity(
        'velocity', Kind.FLOAT32, 'm/s', 'rate of the range; NaN where not known', lambda r: r.value('velocity'),
        measured=True,
    ),
    Quantity('range_integer', Kind.INT32, '0.1 mm', 'range', _scaled('range'), registers_only=True),
    Quantity(
        'protection_level_integer', Kind.INT32, '0.1 mm', 'protection_level, 2147483647 where infinite',
        _scaled('protection_level'), registers_only=True,
    ),
    Quantity('velocity_integer', Kind.INT32, '0.1 mm/s', 'velocity', _scaled('velocity'), registers_only=True),
    Quantity(
        'failed_tests', Kind.UINT32, '', 'integrity tests that the range failed: bits in docs/integrity.md',
        lambda r: r.estimate.failed_tests if r.estimate else 0,
    ),
    Quantity(
        'sweep_id', Kind.UINT32, '', 'number of the sweep, modulo 2^32',
        lambda r: r.estimate.sweep_id if r.estimate else 0,
    ),
    Quantity('stamp', Kind.UINT32, 's', 'when the sweep began, Unix time', lambda r: _stamp(r)[0], registers_only=True),
    Quantity('stamp_nanoseconds', Kind.UINT32, 'ns', 'and its fraction', lambda r: _stamp(r)[1], registers_only=True),
)  # fmt: skip
"""In the order of their registers."""


@dataclasses.dataclass(frozen=True)
class GatewayReading:
    """The gateway itself at one instant."""

    pairs: int
    uptime: float  # [s]
    controller: int  # 0 not expected to write, 1 alive, 2 silent
    controller_heartbeat: int


@dataclasses.dataclass(frozen=True)
class GatewayQuantity:
    """One number about the gateway."""

    name: str
    kind: Kind
    unit: str
    description: str
    read: Callable[[GatewayReading], float]


GATEWAY_QUANTITIES: tuple[GatewayQuantity, ...] = (
    GatewayQuantity('map_version', Kind.UINT16, '', 'version of this map', lambda g: MAP_VERSION),
    GatewayQuantity('pairs', Kind.UINT16, '', 'number of pair blocks', lambda g: g.pairs),
    GatewayQuantity(
        'heartbeat', Kind.UINT16, '', 'advances ten times a second; unchanged for 0.5 s: the gateway hangs',
        lambda g: g.uptime / HEARTBEAT_INTERVAL,
    ),
    GatewayQuantity(
        'controller_state', Kind.UINT16, '', "the controller's heartbeat: 0 not expected, 1 alive, 2 silent",
        lambda g: g.controller,
    ),
    GatewayQuantity('uptime', Kind.UINT32, 's', 'since the start of the gateway', lambda g: g.uptime),
    GatewayQuantity(
        'controller_heartbeat_echo', Kind.UINT16, '', 'what the controller wrote last', lambda g: g.controller_heartbeat
    ),
)  # fmt: skip
"""In the order of their registers."""


def controller_state(controller: Controller, now: float) -> int:
    """Return the value of `controller_state`."""
    if math.isnan(controller.timeout):
        return 0
    return 2 if controller.silent(now) else 1


def offsets(quantities: Sequence[Quantity | GatewayQuantity]) -> dict[str, int]:
    """Return {name: first register within its block}."""
    found, offset = {}, 0
    for quantity in quantities:
        found[quantity.name] = offset
        offset += quantity.kind.size
    return found


def pair_registers(reading: Reading) -> list[int]:
    """Return a pair's block."""
    return [word for q in PAIR_QUANTITIES for word in q.kind.registers(q.read(reading))]


def gateway_registers(reading: GatewayReading) -> list[int]:
    """Return the gateway's block."""
    return [word for q in GATEWAY_QUANTITIES for word in q.kind.registers(q.read(reading))]


PAIR_REGISTERS = sum(q.kind.size for q in PAIR_QUANTITIES)
GATEWAY_REGISTERS = sum(q.kind.size for q in GATEWAY_QUANTITIES)
"""Lengths of the blocks."""


def _rows(quantities: Sequence[Quantity | GatewayQuantity], title: str, name: str) -> list[str]:
    rows = [f'| {title} | {name} | type | unit | meaning |', '| - | - | - | - | - |']
    for q, offset in zip(quantities, offsets(quantities).values(), strict=True):
        rows.append(f'| {offset} | `{q.name}` | {q.kind.name.lower()} | {q.unit} | {q.description} |')
    return rows


def gateway_table() -> str:
    """Return the gateway's input registers as a Markdown table."""
    return '\n'.join(_rows(GATEWAY_QUANTITIES, 'register', 'gateway'))


def pair_table() -> str:
    """Return a pair's input registers as a Markdown table."""
    return '\n'.join(_rows(PAIR_QUANTITIES, 'register', 'pair'))


def opcua_table() -> str:
    """Return the OPC UA variables of a pair as a Markdown table."""
    rows = ['| variable | data type | status | meaning |', '| - | - | - | - |']
    for q in PAIR_QUANTITIES:
        if not q.registers_only:
            kind = {Kind.UINT16: 'UInt16', Kind.UINT32: 'UInt32'}.get(q.kind, 'Double')
            unit = f' [{q.unit}]' if q.unit else ''
            status = 'of the range' if q.measured else 'Good'
            rows.append(f'| `{q.name}` | {kind} | {status} | {q.description}{unit} |')
    return '\n'.join(rows)


def quality_table() -> str:
    """Return the bits of the quality word as a Markdown table, from the documentation of `Quality`."""
    rows = ['| bit | value | name | meaning |', '| - | - | - | - |']
    for bit, quality in enumerate(Quality):
        rows.append(f'| {bit} | {int(quality)} | `{quality.name}` | {QUALITY_MEANINGS[quality]} |')
    return '\n'.join([*rows, '| 8 ... 15 | | | `RangeEstimate.flags` of the last range |'])


QUALITY_MEANINGS = {
    Quality.VALID: 'use the range',
    Quality.DOUBTFUL: 'use it with a margin of `protection_level`, or for coarse moves',
    Quality.REFUSED: 'do not use it',
    Quality.STALE: 'nothing new within `timeout`, or the stamp is off the clock: do not use it',
    Quality.NO_RANGE: 'none since the start of the gateway',
    Quality.LATE: 'the stamp differs from the clock by more than `age_limit` (with `STALE`)',
    Quality.MIXED: "two nodes publish this pair's ranges (with `REFUSED` or `STALE`)",
    Quality.CONTROLLER_SILENT: "the controller's heartbeat has not changed within `controller_timeout`",
}
"""What each bit means, for the documentation."""
