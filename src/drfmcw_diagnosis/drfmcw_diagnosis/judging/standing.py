"""Which effects of an explanation are there beyond doubt, although the explanation leaves something over.

A real effect predicts what it was not fitted to: its size agrees from distance to distance and from kind to kind of
number, it is absent from no distance, and fitted without one distance it predicts that distance. An imitation of
something unknown has a size of its own wherever it is measured. Both are measured on cells, a cell being the numbers of
one kind at one station in one group of sweeps; of its spectrum only the bins that the effect changes. What one group
alone shows, as clipping where the stations are nearest, no other distance can confirm; then one kind of number must
predict the other, or be one that nothing else changes, as samples that pile up at a limit. Where one distance alone is
compared, both halves of the noise bands predict each other.

What the range alone shows is a smooth curve of distance, time or temperature, which something unknown may be as well.
So an effect of that kind is also in doubt where a freer curve of the same condition explains much of what is left,
measured by what the effect explains and the others cannot follow, see `curves`; where it depends on no condition alone
and much is left; where others of that kind, which may nearly cancel it, make it many times less certain than it would
be without them; and where the rest of the phases over the sweep may shift the range half as far. An error of the
reference moves the fringes of a reflection as well. Beside something without a name that is set aside, one that these
show more than the range is in doubt where much is left of the range as measured: that may be how far the crane stands
from the reference, too. What range and beat frequency alone show is in doubt where a step explains as much.

What is set aside is known to first order only. So an effect that shows in the same numbers, and explains less than a
thousandth of what that does, is in doubt; nor does the search add it.

Two effects of any kind that nearly cancel each other are in doubt: nature has no reason to balance them, but a fit to
something unknown has.

What shows over the sweep alone is in doubt where an event at one time of the sweep explains as much, see `events`, or a
course of one receiver's line, see `courses`, and a second path where one of a reflector that stands still or is there
along a part of the track does, see `paths`. What is left beside an effect is what is left beside the events that are
set aside as well.

Bursts that last longer than a sweep are in doubt: whatever makes some sweeps noisier than others does as much. So are
bursts that are stronger near the line, whose own power they are, see `bursts`. A sway is where a drift that all groups
share explains nearly as much, see `drifts`.

What has a random phase in each sweep is in doubt where its size scatters as that of noise, or where the amplitudes are
modulated at the same rate, as a second path does that swings, see `compare.steadiness`.

What the noise alone shows is in doubt where the amplitude of the same receiver's line is unexplained by half as many
decibels: whatever changes a receiver's gain changes both; and where a third of it repeats in each sweep, as what an
event within the ramp leaves there does. What the received power alone shows is in doubt where the amplitude over the
sweep is unexplained by half as much: whatever changes that changes its mean; and where a stretch of a condition
explains more, see `stretches`. Lines of one receiver are in doubt where something is left at their multiples, or one is
a harmonic of another. See `receivers`.
"""

import dataclasses

import numpy as np
from scipy import stats

from drfmcw_sim.effects import ActsOn, Motion

from ..compare.algebra import scaled_inverse
from ..compare.limits import MODEL
from ..compare.steadiness import LIMITS as STEADINESS
from ..compare.steadiness import amplitude_modulations, odds_of_one_size
from ..search.courses import LIMITS as COURSES
from ..search.courses import beyond_courses
from ..search.events import beyond_events, over_set_aside
from ..search.fits.fitted import Fitted, FittedEffect, Freedom, cells_of, series_of
from ..search.fits.fitting import Fitting
from ..search.limits import EVENTS
from .bursts import LIMITS as BURSTS
from .bursts import of_lines
from .curves import LIMITS as CURVES
from .curves import bent, beyond_steps
from .drifts import drifting
from .evidence import clean, dominated, excess, of_uneven_converters, significantly_left
from .parts import chance_of_sizes, largest_share, smallest_size, unevenness, without_each
from .paths import LIMITS as PATHS
from .paths import beyond_paths
from .receivers import (
    harmonics,
    left_at_multiples,
    of_level,
    repeated_noise,
    uneven_power,
    unexplained_course,
    unexplained_signal,
)
from .stretches import LIMITS as STRETCHES
from .stretches import beyond_stretches


@dataclasses.dataclass(frozen=True)
class StandingLimits:
    """What an effect must show; chosen on recordings by another hand, see docs/diagnosis.md."""

    over_groups: float = 0.1  # mean squared relative difference of its size from group to group, beyond noise [1]
    over_kinds: float = 0.2  # the same from kind to kind [1]
    visible: float = 50.0  # power of an effect in a group from which on it must be seen there (7 sigma) [1]
    smallest: float = 0.25  # its size in such a group, or exact kind of number, over that in all, at least [1]
    predicted: float = 0.5  # share of its gain in each part that a fit without this part predicts, at least [1]
    evidence: float = 0.2  # share of its gain that lies in clean cells, at least [1]
    probability: float = 1e-9  # chance of the gain in clean cells, at most [1]
    certain: float = 5.0  # size over its standard deviation with all that is unknown as noise, at least [1]
    alone: float = 0.98  # share of its power in one part above which no other part can confirm it [1]
    by_range: float = 0.98  # share of its power in the range above which nothing else shows it [1]
    left: float = 0.05  # rest of the range over what one effect alone, which shows in nothing else, explains of it [1]
    bent: float = 0.02  # what a freer curve of its condition explains of that rest, over the same [1]
    course: float = 0.5  # shift of the range by the rest of the phases over an effect's change of it, at most [1]
    unexplained: float = 0.5  # rest of a receiver's amplitude over an effect's change of its noise, at most [1]
    uneven_power: float = 0.5  # rest of the amplitude over the sweep over an effect's change of the power, at most [1]
    repeated: float = 0.3  # share of what an effect adds to the noise that repeats in each sweep, at most [1]
    multiples: float = 0.005  # rest of the spectrum at multiples of a line over what the line explains, at most [1]
    determined: float = 0.01  # least share of the information on a parameter that other parts must have [1]
    determined_apart: float = 0.05  # the same of what each group has by itself: less says nothing of it [1]
    alike: float = 0.5  # cosine between what two effects add, from which on they may cancel [1]
    cancelled: float = 4.0  # power of an effect over that of the sum with all that may cancel it, at most [1]
    by_chance: float = 1e-6  # chance of sizes that differ more than `over_groups` or `over_kinds`, at most [1]
    drifting: float = 0.9  # what a drift that all groups share explains over what a sway explains, at most [1]
    lasting: float = 1.0  # time that a burst lasts over the sweep's duration, at most [1]
    inflated: float = 5.0  # standard deviation beside others that the range alone shows, over that without them [1]


LIMITS = StandingLimits()


@dataclasses.dataclass(frozen=True)
class Standing:
    """How well one effect of an explanation stands by itself."""

    over_groups: float  # see `StandingLimits`
    over_kinds: float
    predicted: float
    evidence: float
    probability: float
    testable: bool  # more than one group shows it, or more than one kind of number, or one that nothing else changes
    gain: float  # misfit that it explains beside the others
    smallest: float = 1.0  # of effects that act in every group
    certain: float = np.inf  # of effects with a size that may be zero
    left: float = 0.0  # of effects that the range alone shows, and that depend on no condition alone, or of a reference
    bent: float = 0.0  # of effects that the range alone shows, and that depend on one
    course: float = 0.0  # of effects that the range alone shows
    beyond_step: float = np.inf  # of effects that range and beat frequency alone show
    beyond_stretch: float = np.inf  # of effects that the received power alone shows
    unexplained: float = 0.0  # of effects that the noise alone shows
    uneven_power: float = 0.0  # of effects that the received power alone shows
    repeated: float = 0.0  # of effects that the noise alone shows
    multiples: float = 0.0  # of effects that are a line in the spectrum
    inflated: float = 1.0  # of effects that the range alone shows
    over_aside: float = np.inf  # of effects that show in the numbers of what is set aside
    cancelled: float = 1.0
    beyond_event: float = np.inf  # of effects that show over the sweep alone
    beyond_course: float = np.inf  # of effects that show over the sweep alone
    beyond_path: float = np.inf  # of second paths
    one_size: float = np.inf  # log odds of one size against noise, of effects of random phase
    of_amplitude: float = 0.0  # of effects of random phase
    lasting: float = 0.0  # of bursts
    of_line: float = 0.0  # of bursts
    drifting: float = 0.0  # of a sway
    is_harmonic: bool = False  # or the fundamental of another line of the explanation

    @property
    def stands(self) -> bool:
        """True where the effect is there beyond doubt."""
        return (
            self.testable
            and self.over_groups < LIMITS.over_groups
            and self.over_kinds < LIMITS.over_kinds
            and self.smallest > LIMITS.smallest
            and self.predicted > LIMITS.predicted
            and self.has_evidence
            and self.certain > LIMITS.certain
            and self.left < LIMITS.left
            and self.bent < LIMITS.bent
            and self.course < LIMITS.course
            and self.unexplained < LIMITS.unexplained
            and self.uneven_power < LIMITS.uneven_power
            and self.repeated < LIMITS.repeated
            and self.multiples < LIMITS.multiples
            and self.of_amplitude < STEADINESS.of_amplitude
            and self.lasting < LIMITS.lasting
            and self.of_line < BURSTS.nearer
            and self.drifting < LIMITS.drifting
            and not self.is_harmonic
            and self.inflated < LIMITS.inflated
            and self.over_aside > EVENTS.faint
            and not self.is_cancelled
            and not self.is_event
            and self.beyond_course > COURSES.beaten
            and self.beyond_stretch > STRETCHES.beaten
            and not self.is_path
            and not self.is_noise
        )

    @property
    def has_evidence(self) -> bool:
        """True where numbers of which little else is left show it beyond doubt."""
        return self.evidence > LIMITS.evidence and self.probability < LIMITS.probability

    @property
    def is_cancelled(self) -> bool:
        """True where others nearly cancel the effect: together they follow a curve that nobody knows."""
        return self.cancelled > LIMITS.cancelled

    @property
    def is_event(self) -> bool:
        """True where a step or a bump within the sweep, or a step over a condition, explains more than the effect."""
        return self.beyond_event < EVENTS.beaten or self.beyond_step < CURVES.beaten

    @property
    def is_path(self) -> bool:
        """True where a second path without a name explains more than all those of the explanation."""
        return self.beyond_path < PATHS.beaten

    @property
    def is_noise(self) -> bool:
        """True where its size scatters from sweep to sweep as that of noise."""
        return self.one_size < STEADINESS.unlikely


def standings(fitting: Fitting, fitted: Fitted) -> list[Standing]:
    """Return how well each effect of an explanation stands by itself, in order."""
    entries = fitting.comparison.entries
    whitening = fitting.whitening
    as_it_is = fitting.whitening_of(fitted, with_unknown=False)
    # nothing is clean because it counts as noise; an event that is set aside takes few of the numbers with it
    as_measured = as_it_is.beside(fitting.set_aside)
    residual = fitting.comparison.residual - fitted.template
    rest, left_over, as_left = whitening(residual), as_measured(residual), as_it_is(residual)
    derivatives = fitting.slopes(fitted)
    slopes = whitening(derivatives)
    groups, kinds, cells = entries.group, _confirming(fitting), cells_of(entries)
    exact = np.isin(np.arange(len(groups)), fitting.comparison.rows_of_kinds(lambda kind: kind.exact))
    least = np.full(len(slopes), LIMITS.determined)
    for effect, own in zip(fitted.effects, fitted.spans, strict=True):
        if effect.candidate.recipe.per_group:
            least[own] = LIMITS.determined_apart
    changes = {
        name: without_each(rest, slopes, parts, least)[parts] for name, parts in (('group', groups), ('kind', kinds))
    }
    significant = significantly_left(fitting, fitted, derivatives)
    converters = of_uneven_converters(fitting, significant, as_measured(fitted.template))
    by_range = [_by_range(fitting, effect) for effect in fitted.effects]
    inflations = _inflations(fitted, slopes, by_range)
    beyond, one_size = beyond_events(fitting, fitted), odds_of_one_size(fitting.comparison, fitted.build())
    of_amplitude = amplitude_modulations(fitting.comparison, fitted.build())
    lines = of_lines(fitting, fitted)
    cancelled, steps = cancellations(fitting, fitted), beyond_steps(fitting, fitted)
    paths, periodic = beyond_paths(fitting, fitted), harmonics(fitting, fitted)
    courses, stretches = beyond_courses(fitting, fitted), beyond_stretches(fitting, fitted)
    drifts = drifting(fitting, fitted)
    curves = bent(fitting, fitted, slopes, rest, as_it_is) if any(by_range) else [None] * len(by_range)
    of_range = of_level(fitting, 'range')
    of_limits = fitting.comparison.rows_of_kinds(lambda kind: kind.unmistakable)
    unmistakable = of_limits[~converters[of_limits]]
    found = []
    for number, own in enumerate(fitted.spans):
        alone = fitting.added_beside(fitted, number)
        added, measured = whitening(alone), as_measured(alone)
        per_group = fitted.effects[number].candidate.recipe.per_group
        # sizes of single groups can neither predict nor confirm each other
        by_group = largest_share(added, groups) < LIMITS.alone and not per_group
        bursts = fitted.effects[number].candidate.kind.bursts
        without = changes['group' if by_group else 'kind']
        moved = np.einsum('np,pn->n', without, slopes)
        moved_own = np.einsum('np,pn->n', without[:, own], slopes[own])
        free = own.stop - own.start
        drives = fitted.effects[number].candidate.kind.motion is Motion.DRIVE
        if drives:  # the phase shows a movement far better than all else, but any other drift of a delay as well
            testable = (1.0 - largest_share(added, kinds)) * float(added @ added) > LIMITS.visible
        else:
            clear = float(np.sum(added[unmistakable] ** 2)) > LIMITS.visible
            testable = by_group or bursts or clear or largest_share(added, kinds) < LIMITS.alone
        evident = clean(fitting, significant, left_over, measured, cells) & ~converters
        counted = ~dominated(left_over, measured, cells)
        sound = counted & ~converters
        standing = _standing(rest, added, moved, moved_own, groups, kinds, evident, counted, sound, free, testable)
        in_range = float(measured[of_range] @ measured[of_range])
        explained = in_range * _own_share(slopes, own, added)
        curve = curves[number]
        left = excess(left_over[of_range]) / explained if by_range[number] and curve is None else 0.0
        of_reference = ActsOn.REFERENCE in fitted.effects[number].candidate.kind.acts_on
        if of_reference and len(fitting.set_aside) and 2.0 * in_range < float(measured @ measured):
            shown = as_it_is(alone)[of_range]
            left = max(left, excess(as_left[of_range]) / max(float(shown @ shown), 1e-30))
        # a group holds few bursts, so each part of the numbers knows their size to that only; numbers of all groups
        # together, of spans and of windows of several lengths, confirm each other where little is left of them
        doubt = MODEL.bursts**2 if bursts else 0.0
        found.append(
            dataclasses.replace(
                standing,
                over_groups=standing.over_groups - doubt,
                over_kinds=standing.over_kinds - doubt,
                predicted=1.0 if bursts else standing.predicted,
                smallest=min(
                    _smallest(rest, added, groups, counted) if by_group and not bursts else 1.0,
                    _smallest(rest, added, kinds, counted & exact),
                ),
                certain=_certainty(fitted.effects[number], slopes, own),
                left=left,
                bent=curve / explained if by_range[number] and curve is not None else 0.0,
                course=unexplained_course(fitting, residual, alone, as_it_is.weight) if by_range[number] else 0.0,
                beyond_step=steps[number],
                unexplained=unexplained_signal(fitting, fitted.effects[number], residual, alone),
                uneven_power=uneven_power(fitting, fitted.effects[number], residual, alone),
                repeated=repeated_noise(fitting, fitted.effects[number], alone),
                multiples=left_at_multiples(fitting, fitted.effects[number], left_over, measured),
                inflated=inflations[number],
                cancelled=cancelled[number],
                beyond_event=beyond[number],
                beyond_course=courses[number],
                beyond_stretch=stretches[number],
                beyond_path=paths[number],
                one_size=one_size[number],
                of_amplitude=of_amplitude[number],
                of_line=lines[number],
                lasting=_lasting(fitting, fitted.effects[number]) if bursts else 0.0,
                drifting=drifts[number],
                is_harmonic=periodic[number],
            )
        )
    over_aside = over_set_aside(fitting, fitted, as_it_is, {number: one.gain for number, one in enumerate(found)})
    return [dataclasses.replace(one, over_aside=x) for one, x in zip(found, over_aside, strict=True)]


def uneven(fitting: Fitting, fitted: Fitted) -> list[bool]:
    """Return of which effects groups or kinds of numbers show sizes that differ, by more than chance, in order.

    Something else imitates such an effect, also where no kind of number shows by itself that it leaves anything.
    Bursts differ by chance.
    """
    c = fitting.comparison
    rest = fitting.whitening(c.residual - fitted.template)
    either = (c.entries.group, LIMITS.over_groups), (_confirming(fitting), LIMITS.over_kinds)

    def differs(number: int) -> bool:
        added = fitting.whitening(fitting.added_beside(fitted, number))
        return any(
            unevenness(rest, added, parts) > most and chance_of_sizes(rest, added, parts) < LIMITS.by_chance
            for parts, most in either
        )

    return [not effect.candidate.kind.bursts and differs(number) for number, effect in enumerate(fitted.effects)]


def _certainty(effect: FittedEffect, slopes: np.ndarray, own: slice) -> float:
    """Return the size of an effect over its standard deviation, infinity where it is a level or one of several.

    An uncertain shape makes the size uncertain too, but says nothing of whether it is there: of the parameters only
    those of other effects are free. But a sway whose size and frequency make up for each other is so slow that any
    drift within the groups looks like it.

    Args:
        effect: of the explanation.
        slopes: whitened derivatives by all parameters (P, n).
        own: the effect's among them.
    """
    recipe = effect.candidate.recipe
    if not recipe.may_vanish:
        return np.inf
    size = own.start + effect.candidate.free.index(recipe.size)
    held = size if effect.candidate.kind.motion is Motion.SWAY else own
    left = Freedom(np.delete(slopes, held, axis=0)).left(slopes[size])
    return abs(effect.values[recipe.size]) * float(np.linalg.norm(left))


def _smallest(rest: np.ndarray, added: np.ndarray, parts: np.ndarray, used: np.ndarray) -> float:
    """Return `smallest_size` of the numbers that are used (n,)."""
    return smallest_size(rest[used], added[used], parts[used], LIMITS.visible)


def _lasting(fitting: Fitting, effect: FittedEffect) -> float:
    """Return the longest time within a sweep that an effect names over the sweep's duration."""
    duration = min(sweep.ramp_duration for sweep in fitting.comparison.data.sweeps[0])
    return max((effect.values[name] for name in effect.candidate.recipe.within_sweep), default=0.0) / duration


def cancellations(fitting: Fitting, fitted: Fitted) -> list[float]:
    """Return the power of what each effect adds over that of its sum with all effects that add much the same."""
    added = fitting.added_alone(fitted)
    products = added @ added.T
    length = np.sqrt(np.maximum(np.diag(products), 1e-30))
    alike = np.abs(products) > LIMITS.alike * np.outer(length, length)
    together = [float(np.sum(products[np.ix_(own, own)])) for own in alike]
    return [float(power / max(total, 1e-30)) for power, total in zip(length**2, together, strict=True)]


def _own_share(slopes: np.ndarray, own: slice, added: np.ndarray) -> float:
    """Return the share of what an effect adds (n,) that the other effects' parameters cannot follow.

    Args:
        slopes: whitened derivatives by all parameters (P, n).
        own: the effect's among them.
        added: by the effect, whitened (n,).
    """
    followed = float(Freedom(np.delete(slopes, own, axis=0)).followed(added))
    return max(1.0 - followed / max(float(added @ added), 1e-30), 1e-6)


def _inflations(fitted: Fitted, slopes: np.ndarray, alike: list[bool]) -> list[float]:
    """Return by how much effects that the range alone shows make each other less certain; 1 for all others.

    Args:
        fitted: the explanation.
        slopes: whitened derivatives of its template by its parameters (P, n).
        alike: whether the range alone shows each effect.
    """
    spans = fitted.spans
    by_range = [i for i, alone in enumerate(alike) if alone]
    std = np.sqrt(np.diag(scaled_inverse(slopes @ slopes.T)))
    found = [1.0] * len(spans)
    for i in by_range:
        other = {k for j in by_range if j != i for k in range(spans[j].start, spans[j].stop)}
        kept = [k for k in range(len(slopes)) if k not in other]
        alone = np.sqrt(np.diag(scaled_inverse(slopes[kept] @ slopes[kept].T)))
        own = [kept.index(k) for k in range(spans[i].start, spans[i].stop)]
        found[i] = float(np.max(std[spans[i]] / alone[own], initial=1.0))
    return found


def _by_range(fitting: Fitting, effect: FittedEffect) -> bool:
    """Return whether an effect, alone, shows in the range and in nothing else."""
    if effect.candidate.acts:
        return False
    added = fitting.whitening.weight * fitting.comparison.template([effect.build()])
    of_range = added[of_level(fitting, 'range')]
    return float(of_range @ of_range) > LIMITS.by_range * float(added @ added)


def _confirming(fitting: Fitting) -> np.ndarray:
    """Return which part each number belongs to, of those that confirm each other (n,): one kind at one station.

    Of one distance alone either half of a kind that can be divided.
    """
    c = fitting.comparison
    parts = 2 * series_of(c.entries)
    if not c.entries.group.any():
        for kind, station in c.series():
            if kind.divisible:
                rows = c.rows(kind, station)
                place = c.entries.position[rows]
                parts[rows] += place > np.median(place)
    return np.unique(parts, return_inverse=True)[1]


def _standing(
    rest: np.ndarray,
    added: np.ndarray,
    moved: np.ndarray,
    moved_own: np.ndarray,
    groups: np.ndarray,
    kinds: np.ndarray,
    clean: np.ndarray,
    counted: np.ndarray,
    sound: np.ndarray,
    free: int,
    testable: bool,
) -> Standing:
    """Return how well an effect stands by itself; arrays (n,), whitened.

    Args:
        rest: what the explanation leaves.
        added: what the effect adds to it.
        moved: by how much the explanation changes in each part when it is fitted without this part.
        moved_own: the same by the effect's own parameters alone.
        groups: number of each number's group.
        kinds: of its kind and station.
        clean: which numbers can be evidence.
        counted: which something else does not dominate.
        sound: of these, which no uneven ADC made.
        free: parameters of the effect.
        testable: whether more than one part shows the effect, or one that nothing else changes.
    """
    gain = np.where(counted, (rest + added) ** 2 - rest**2, 0.0)
    left = rest - moved
    predicted = np.where(counted, (left + added + moved_own) ** 2 - left**2, 0.0)
    total = max(float(gain.sum()), 1e-30)
    return Standing(
        over_groups=unevenness(rest[sound], added[sound], groups[sound]),
        over_kinds=unevenness(rest[sound], added[sound], kinds[sound]),
        predicted=float(predicted.sum()) / total,
        evidence=float(gain[clean].sum()) / total,
        probability=float(stats.chi2.sf(max(float(gain[clean].sum()), 0.0), free)),
        testable=testable,
        gain=total,
    )
