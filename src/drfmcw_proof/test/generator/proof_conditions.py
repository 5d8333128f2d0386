"""Small conditions of the proof's generator, for its tests."""

import dataclasses
import math

import numpy as np

from drfmcw_proof.cases.concealing import Applied, conceal
from drfmcw_proof.generator.condition import Condition
from drfmcw_proof.generator.model import FIRST, SECOND, clean, nominal

BOTH = (FIRST, SECOND)


def condition(distances=(60.0, 300.0, 900.0), sweeps=4, stations=None, board=(35.0, 30.0), **changes):
    """Return a small condition in ordinary weather."""
    n = len(distances)
    fields = {
        'seed': 7,
        'air_temperature': (15.0,) * n,
        'air_pressure': (101325.0,) * n,
        'air_humidity': (0.5,) * n,
        'board_temperature': tuple((b,) * n for b in board),
    }
    if stations is not None:
        fields['stations'] = stations
    return Condition(distances=distances, sweeps=sweeps, **{**fields, **changes})


def quiet(c):
    """Return the condition without noise worth the name."""
    stations = tuple(dataclasses.replace(s, noise_floor=-250.0, phase_noise_level=-250.0) for s in c.stations)
    return dataclasses.replace(c, stations=stations, reference_std=0.0)


def with_effect(c, effect, station=None, **parameters):
    """Return the scene with and the scene without an effect."""
    return conceal(nominal(c), [Applied(effect, station, parameters)]), nominal(c)


def phase_change(scene, before, station, rows):
    """Return what an effect adds to the IF phase [rows, samples] [rad], NaN where a chirp is off."""
    new, old = clean(scene, station, rows), clean(before, station, rows)
    on = (new != 0.0) & (old != 0.0)
    ratio = np.where(on, new / np.where(on, old, 1.0), 1.0)
    return np.where(on, np.unwrap(np.angle(ratio)), np.nan)


def slope(change):
    """Return the frequency [rows] [Hz] of phases, between the same samples of each."""
    return (change[:, 2000] - change[:, 100]) * 2.048e6 / 1900 / (2.0 * math.pi)
