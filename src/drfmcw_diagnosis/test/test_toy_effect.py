"""Effects are known in their own files alone: one that is declared here is simulated, concealed and found."""

import ast
import dataclasses

import numpy as np
import pytest
from checkout import ROOT
from scenes import record, scene

from drfmcw_diagnosis.engine import diagnose
from drfmcw_diagnosis.finding.wording import effect_sentence
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.settings import parameter
from drfmcw_sim.effects import ActsOn, Effect, Of, Recipe
from drfmcw_sim.measurements import Station

TRUE = {'deviation': 600.0, 'rate': 7000.0, 'phase': 0.7}
STANDING = {'distances': [120.0, 160.0, 210.0, 260.0, 320.0, 390.0], 'sweeps': 12}
SOURCES = ROOT / 'src'


@pytest.fixture
def sawtooth():
    """Name of a ripple with two harmonics, registered for the time of a test."""

    @dataclasses.dataclass(frozen=True)
    class SawtoothRipple(Effect, name='sawtooth_ripple', of=Of.STATION):
        """Frequency error of a DAC's steps, locked to the sweep: a fundamental and half as much of its double."""

        headline = 'The ramp ripples in steps.'
        acts_on = ActsOn.PHASE
        shapes_chirp = True
        formula = 'δf(t) = deviation (sin x + ½ sin 2x), x = 2π rate t + phase'
        example = {'deviation': 200.0, 'rate': 5000.0}
        recipes = (
            Recipe(
                'deviation',
                start={'deviation': 20.0},
                prior={'deviation': 2e3, 'rate': 5e4, 'phase': 3.0},
                quadrature=('phase', np.pi / 2.0),
                steps={'rate': 5.0, 'phase': 0.01},
                scan='ripple',
                scanned='rate',
                cells=60,
            ),
        )

        deviation: float = parameter(unit='Hz', bounds=(-1e8, 1e8), description='of the fundamental')
        rate: float = parameter(unit='Hz', bounds=(1.0, 1e9), description='of the fundamental')
        phase: float = parameter(0.0, unit='rad', bounds=(-10.0, 10.0), description='where the ramp starts')

        def chirp_phase(self, station: Station, u: np.ndarray) -> np.ndarray:
            """Return the integral of the frequency error over the station's own time [rad]."""
            x = 2.0 * np.pi * self.rate * station.alpha[:, None] * u + self.phase
            return -(self.deviation / self.rate) * (np.cos(x) + 0.25 * np.cos(2.0 * x))

    yield SawtoothRipple.name
    del Effect.registry[SawtoothRipple.name]


def test_an_effect_declared_outside_of_the_packages_is_found(tmp_path, sawtooth):
    """Its parameters lie within 4 standard deviations; the recording is fixed, so nothing is by chance."""
    concealed = {'effect': sawtooth, 'station': 'slave'} | TRUE
    scenario = scene({'standing': STANDING}, effects=[concealed], reference={'range_std': 0.005})
    found = diagnose(record(scenario, tmp_path / 'r'))
    assert found.verdict in ('explained', 'ambiguous')
    (effect,) = found.explanation.effects
    assert (effect.effect, effect.station) == (sawtooth, 'slave')
    for name, true in TRUE.items():
        assert abs(effect.parameters[name].value - true) < 4.0 * effect.parameters[name].std, name
    assert 'Sawtooth ripple at slave: the ramp ripples in steps.' in effect_sentence(effect)


@pytest.mark.parametrize('package', ['drfmcw_sim', 'drfmcw_diagnosis'])
def test_no_module_names_an_effect_but_its_own(package):
    """Neither in a condition nor in a table; fields of a calibration may have the name of an effect."""
    names = set(Effect.registry) - {field.name for field in dataclasses.fields(Calibration)}
    modules = sorted((SOURCES / package / package).rglob('*.py'))
    assert modules
    for module in modules:
        own = module.stem if module.parent.name == 'effects' else ''
        nodes = ast.walk(ast.parse(module.read_text(encoding='utf-8')))
        texts = {node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)}
        assert texts & names <= {own}, module
