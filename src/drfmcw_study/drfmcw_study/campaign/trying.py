"""One row of the campaign: a fault or a network, tried at all distances; runs in a worker of any kind."""

import dataclasses

from .faults import faults
from .measuring import Counts, cases, measure
from .network import NetworkRow, network_row, networks
from .report import Row


@dataclasses.dataclass(frozen=True)
class Try:
    """One fault to try, by name, since functions do not reach another process."""

    fault: str  # or network
    size: str  # '' of a network
    sweeps: int
    seed: int


def tried(order: Try) -> Row | NetworkRow:
    """Return what comes of a fault or a network at all distances."""
    if not order.size:
        network = next(network for network in networks() if network.name == order.fault)
        return network_row(network, order.sweeps, order.seed)
    fault = next(fault for fault in faults() if (fault.name, fault.size) == (order.fault, order.size))
    found: list[Counts] = [measure(case) for case in cases(fault, order.sweeps, order.seed)]
    return Row(
        fault.name,
        fault.size,
        sum(c.sweeps for c in found),
        sum(c.valid for c in found),
        sum(c.wrong for c in found),
        sum(c.beyond for c in found),
        max(c.undetected for c in found),
        max(c.worst for c in found),
    )
