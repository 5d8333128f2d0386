"""Small simulated recordings for the tests."""

from pathlib import Path
from typing import Any

from drfmcw_ros.bag.files import BagReader, BagWriter
from drfmcw_sim.recording import write_recording
from drfmcw_sim.scenario import Scenario, scenario_from_mapping

STANDARD_STATION = {'noise_floor': -140.7, 'phase_noise_level': -90.0, 'phase_noise_corner': 200e3}


def mapping(trajectory: dict[str, Any], alphas: tuple[float, float] = (1.0, 1.0), **sections: Any) -> dict[str, Any]:
    """Return what a scenario file of master and slave on a trajectory holds, e.g. {'standing': {...}}."""
    stations = {
        'master': STANDARD_STATION | {'alpha': alphas[0], 'delay': 12e-9},
        'slave': STANDARD_STATION | {'alpha': alphas[1], 'delay': 15e-9},
    }
    pairs = [{'first': 'master', 'second': 'slave'} | trajectory]
    return {'stations': stations, 'pairs': pairs, 'reference': {'range_std': 0.0}, 'seed': 11} | sections


def scene(trajectory: dict[str, Any], alphas: tuple[float, float] = (1.0, 1.0), **sections: Any) -> Scenario:
    """Return a scenario of master and slave on a trajectory, e.g. {'standing': {...}} or {'drive': {...}}."""
    return scenario_from_mapping(mapping(trajectory, alphas, **sections), 'test')


def record(scenario: Scenario, path: Path) -> Path:
    """Render a scenario into a recording and return its path."""
    write_recording(scenario, path)
    return path


def without(source: Path, target: Path, *topics: str) -> Path:
    """Copy a recording without the topics that hold one of some words; return the copy's path."""
    with BagReader(source) as bag, BagWriter(target) as copy:
        kept = {t for t in bag.topics if not any(word in t for word in topics)}
        for topic, time, message in bag.messages(kept):
            copy.write(topic, bag.topics[topic], time, message)
    return target
