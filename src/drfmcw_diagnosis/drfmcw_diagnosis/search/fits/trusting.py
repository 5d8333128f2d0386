"""How far each number counts: noise, doubt about forward models, and what has no name.

In: an explanation. Out: the whitening of what it leaves, and the misfit that it has then.
"""

import numpy as np

from ...compare.comparison import Comparison
from ...compare.kinds.explained import Explained
from ...compare.limits import MODEL
from ...compare.over_sweep import fadings
from .fitted import Fitted, cells_of, rows_of_series
from .limits import FIT
from .templates import Templates
from .whitening import Whitening


class Trusting(Templates):
    """Weighs the numbers of one comparison by how far forward models are trusted.

    Attributes:
        whitening: of what the explanation leaves that was trusted last.
        set_aside: what has no name, over the numbers' standard deviations and times its prior (k, n).
        noisier: weights (n,), below 1 where something unknown is taken for noise.
    """

    def __init__(self, comparison: Comparison) -> None:
        """Start with forward models that are trusted without limit."""
        super().__init__(comparison)
        self.noisier = np.ones(len(comparison.residual))
        self.set_aside = np.zeros((0, len(comparison.residual)))
        self.whitening = Whitening(self.noisier, comparison.common_errors, comparison.correlated)

    def misfit(self, template: np.ndarray | float) -> float:
        """Return the sum of squared whitened residuals with a template; where one is known, see `trust`."""
        return float(np.sum(self.whitening(self.comparison.residual - template) ** 2))

    def gain_over(self, fitted: Fitted, without: Fitted) -> float:
        """Return by how much an explanation lessens the misfit of one without some of its effects.

        Numbers count as without these effects: what bursts add is uncertain only if there are any.
        """
        whitening = self.whitening_of(without)
        before, after = (whitening(self.comparison.residual - f.template) for f in (without, fitted))
        return float(before @ before - after @ after)

    def trust(self, fitted: Fitted | None) -> None:
        """Trust the forward models to a fraction of what they add: differences below it count as noise."""
        self.whitening = self.whitening_of(fitted)

    def whitening_of(self, fitted: Fitted | None, with_unknown: bool = True) -> Whitening:
        """Return the whitening of what an explanation leaves, where the forward models are off by `doubt`.

        With `with_unknown`, what is set aside may be of any size, and what `count_as_noise` has found counts as noise.
        """
        directions = [self.comparison.common_errors]
        if fitted is not None:
            directions += self._by_chance(fitted)
            directions.append(fadings(self.comparison, fitted.build()))
        if with_unknown:
            directions.append(self.set_aside)
        weight = (self.noisier if with_unknown else 1.0) / np.sqrt(1.0 + self.doubt(fitted) ** 2)
        return Whitening(weight, np.concatenate(directions), self.comparison.correlated)

    def count_as_noise(self, fitted: Fitted | None, apart: np.ndarray, candidates: np.ndarray) -> None:
        """Set aside what has no name; let other numbers that are not explained count by the scatter that they have.

        Numbers scatter in a cell alike: in one kind at one station in one group of sweeps. What one effect more may
        explain of a series, one kind at one station, is no scatter. Numbers of all groups together have none.

        Args:
            fitted: the explanation.
            apart: what is set aside, over the numbers' standard deviations and times its prior (k, n).
            candidates: templates of effects that may explain more (M, n).
        """
        entries = self.comparison.entries
        template = fitted.template if fitted is not None else 0.0
        as_measured = self.whitening_of(fitted, with_unknown=False).beside(apart)
        rest = as_measured(self.comparison.residual - template)
        for rows in rows_of_series(entries):
            one = candidates[:, rows] * as_measured.weight[rows]
            power, along = np.einsum('mj,mj->m', one, one), one @ rest[rows]
            gains = np.where(power > FIT.unfelt, along**2 / np.maximum(power, FIT.unfelt), 0.0)
            best = int(np.argmax(gains)) if len(gains) else -1
            if best >= 0:
                rest[rows] -= one[best] * (along[best] / max(float(power[best]), FIT.unfelt))
        cells = cells_of(entries)
        used = np.bincount(cells, rest != 0.0)
        scatter = np.bincount(cells, rest**2) / np.maximum(used, 1.0)
        self.set_aside, self.noisier = apart, 1.0 / np.sqrt(np.maximum(scatter, 1.0))[cells]
        for kind in (k for k in self.comparison.kinds if k.of_all):
            self.noisier[self.comparison.rows(kind)] = 1.0

    def without_set_aside(self, residual: np.ndarray) -> np.ndarray:
        """Return residuals (n,) without what is set aside, as it fits best."""
        directions = self.set_aside * self.whitening.weight
        normal = directions @ directions.T + np.eye(len(directions))
        sizes = np.linalg.solve(normal, directions @ (residual * self.whitening.weight))
        left: np.ndarray = residual - sizes @ self.set_aside
        return left

    def _by_chance(self, fitted: Fitted) -> list[np.ndarray]:
        """Return by how much templates change by what chance determines in each group by itself, (G, n) each.

        Where the crane stands shows in a reflection; and random phases scatter. Distortions hardly change what that
        does to the lines.
        """
        effects = [e for e in fitted.build() if not e.distorts]
        changed = self.comparison.outcomes(effects)
        if any(e.candidate.recipe.fringes for e in fitted.effects):
            changed.append(self.comparison.displaced(effects))
        template = self.comparison.template(effects) if changed else 0.0
        return [self._by_group(other - template) for other in changed]

    def _by_group(self, change: np.ndarray) -> np.ndarray:
        """Return a change of a template that chance determines in each group by itself (G, n)."""
        groups = self.comparison.entries.group
        return np.where(groups == np.arange(len(self.comparison.members))[:, None], change, 0.0)

    def doubt(self, fitted: Fitted | None) -> np.ndarray:
        """Return how far each whitened number may be off because the forward models are not exact."""
        c = self.comparison
        doubt = np.zeros(len(c.entries.kind))
        if fitted is None:
            return doubt
        explained = self._explained(fitted)
        nonlinear = np.zeros(len(doubt))
        if explained.distorting or explained.bursting:
            linear = [e.build() for e in fitted.effects if not e.candidate.acts]
            nonlinear = fitted.template - (self._template(linear) if linear else 0.0)
        for kind in c.kinds:
            rows = c.rows(kind)
            doubt[rows] = kind.doubt(explained, fitted.template[rows], nonlinear[rows])
        fading = [e for e in fitted.build() if e.memory]
        if fading:  # any share of it may be there
            rows = c.rows_of_kinds(lambda kind: kind.of_begin)
            doubt[rows] = np.hypot(doubt[rows], MODEL.unsettled * self._template(fading)[rows])
        return doubt

    def _explained(self, fitted: Fitted) -> Explained:
        """Return what the doubt about forward models asks of an explanation."""
        c = self.comparison
        acting = [e.candidate.kind for e in fitted.effects]
        incoherent = [
            doubt * abs(effect.values[name])
            for effect in fitted.effects
            for name, doubt in effect.candidate.recipe.incoherence.items()
        ]
        return Explained(
            recorded=c.recorded,
            std=c.std,
            trust=c.known.trust,
            distorting=any(e.distorts for e in acting),
            bursting=any(e.bursts for e in acting),
            incoherence=sum(incoherent),
            uneven=lambda: c.uneven([e.build() for e in fitted.effects]),
            scattering=lambda: c.scattering([e.build() for e in fitted.effects]),
            changing=lambda: c.changing([e.build() for e in fitted.effects]),
        )

    def added_beside(self, fitted: Fitted, *numbers: int) -> np.ndarray:
        """Return what some effects of an explanation add beside the others (n,)."""
        others = [e.build() for i, e in enumerate(fitted.effects) if i not in numbers]
        return fitted.template - self.comparison.template(others) if others else fitted.template

    def added_alone(self, fitted: Fitted) -> np.ndarray:
        """Return what each effect of an explanation adds by itself, whitened (effects, n)."""
        return self.whitening(np.array([self.comparison.template([e.build()]) for e in fitted.effects]))
