"""Fig. 6: the IF spectrum of a single station beside the one that is predicted."""

from collections.abc import Callable, Sequence

import numpy as np

from drfmcw_node.estimators.spectral import window_samples
from drfmcw_physics.sweep import Mode
from drfmcw_sim.synthesis.signal_model import synthesise

from . import figures
from .claims import Claim
from .experiments import (
    NOISE_FLOORS,
    Outcome,
    Point,
    Run,
    additive_density,
    floor_density,
    phase_noises,
    site,
)
from .figures import (
    SpectrumFloor,
    SpectrumPanel,
)
from .section import LABORATORY_DELAY, LABORATORY_PATH, NOMINAL, Finished, Section

SPECTRA = 400
"""Sweeps averaged for the spectra."""


def fig6() -> Section:
    """Return the section on Fig. 6."""

    def finish(outcomes: Sequence[Outcome], run: Run) -> Finished:
        count = min(SPECTRA, run.trials)
        panels = [
            _spectrum_panel(
                f'cable, -40 dBm, T_off = {LABORATORY_DELAY * 1e6:.0f} µs', count, run.seed,
                lambda floor: Point(
                    f'fig6 cable {floor}',
                    site('cable', LABORATORY_PATH, floor=floor, alphas=NOMINAL, timing=_STEADY),
                    Mode.SHORT_DISTANCE, LABORATORY_DELAY,
                ),
            ),
            _spectrum_panel(
                'crane at 500 m, short distance, T_off = 3.41 µs', count, run.seed,
                lambda floor: Point(
                    f'fig6 crane {floor}', site('gantry', 500.0, floor=floor, alphas=NOMINAL, timing=_STEADY),
                    Mode.SHORT_DISTANCE,
                ),
            ),
        ]  # fmt: skip
        worst = max(panel.deviation for panel in panels)
        text = f"""Station 1: one sweep, and the mean of {count} sweeps with either noise floor. Predicted: the line
with its Hann lobe, both oscillators' skirts around the line and its mirror lines, noise floor and quantisation. In
bands of 32 bins away from the line the simulated mean stays within {worst:.2f} dB of it."""
        claim = Claim(
            'V-A, Fig. 6',
            'simulated and measured IF spectrum alike',
            f'simulated against predicted density: within {worst:.2f} dB',
            worst < 0.5,
            'the measurement itself is not published as numbers',
        )
        return Finished(figures.spectra(panels), text, (claim,))

    return Section('fig6', 'IF spectrum of a single station', (), finish)


_STEADY = {'start_delay_jitter': 0.0, 'amplitude_scatter': 0.0}


def _spectrum_panel(title: str, count: int, seed: int, make: Callable[[str], Point]) -> SpectrumPanel:
    """Return one panel of Fig. 6; `make` makes the point of a noise floor."""
    floors, deviation = {}, 0.0
    for floor in NOISE_FLOORS:
        point = make(floor)
        scenario = point.seeded(seed)
        m = point.conditions(count)
        station = m.stations[0]
        sweep = station.sweep
        start, end = sweep.analysis_window()
        window = window_samples('hann', start, end, sweep.sample_rate, sweep.sample_count)
        unit = station.full_scale**2 / 2.0 / 10.0 ** (sweep.full_scale_power / 10.0)  # LSB^2 per mW
        samples = synthesise(m, scenario.seed, scenario.effects)[0]
        power = 2.0 * np.abs(np.fft.rfft(samples * window)) ** 2 / window.sum() ** 2 / unit  # a sine reads its power
        frequency = np.arange(power.shape[1]) * sweep.sample_rate / sweep.sample_count
        resolution = (window**2).sum() / window.sum() ** 2 * sweep.sample_rate
        line, skirt, noise = _expected_spectrum(point, frequency, window)
        predicted = line + (skirt + noise) * resolution
        away = np.abs(frequency - frequency[np.argmax(line)]) > 12e3
        away[:8] = away[-8:] = False
        used = np.flatnonzero(away)[: away.sum() // 32 * 32].reshape(-1, 32)
        mean = power.mean(axis=0)
        ratio = mean[used].mean(axis=1) / predicted[used].mean(axis=1)
        deviation = max(deviation, float(np.abs(10.0 * np.log10(ratio)).max()))
        level = floor_density(floor) + 10.0 * float(np.log10(resolution))
        floors[floor] = SpectrumFloor(10.0 * np.log10(mean), 10.0 * np.log10(predicted), level)
    # example and skirt are those of the last floor, B
    example, skirt = 10.0 * np.log10(power[0]), 10.0 * np.log10(skirt * resolution)
    return SpectrumPanel(title, count, frequency, example, skirt, floors, deviation)


def _expected_spectrum(
    point: Point, frequency: np.ndarray, window: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the line's power [mW], the phase-noise skirt and the additive noise [mW/Hz] at station 1."""
    m = point.conditions()
    station = m.stations[0]
    sweep = station.sweep
    center = sweep.chirp_rate * (sweep.start_delay + float(m.paths[0].delay[0]))  # eq. 1, equal references
    received = 10.0 ** (float(station.received_power[0]) / 10.0)
    t = np.arange(sweep.sample_count) / sweep.sample_rate
    lobe = np.fft.rfft(window * np.cos(2.0 * np.pi * center * t))
    line = received * np.abs(lobe / window.sum() * 2.0) ** 2
    nyquist = sweep.sample_rate / 2
    skirt = np.zeros(len(frequency))
    for noise in phase_noises(m):
        # around the line, its mirror line at -f, and that one's repetition at f_s - f
        for offset in (frequency - center, frequency + center, sweep.sample_rate - frequency - center):
            skirt += np.where(np.abs(offset) <= nyquist, noise.single_sideband(offset), 0.0)
    return line, received * skirt, np.full(len(frequency), additive_density(station))
