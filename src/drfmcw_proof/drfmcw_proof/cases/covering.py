"""Sets of a few effects in which every pair of effects occurs."""

import itertools
from collections.abc import Collection, Sequence

import numpy as np


def covering(effects: Sequence[str], apart: Collection[frozenset[str]]) -> list[tuple[str, ...]]:
    """Return sets of two to four effects in random order, always the same, in which every pair of effects occurs.

    `apart` never occur together: effects that change the data alike.
    """
    random = np.random.default_rng(0)
    pairs = {frozenset(pair) for pair in itertools.combinations(effects, 2)} - set(apart)
    left = sorted(pairs, key=sorted)
    random.shuffle(left)
    missing, found = dict.fromkeys(left), []
    while missing:
        chosen = sorted(next(iter(missing)))
        for _ in range(int(random.integers(3))):
            new = {
                effect: sum(frozenset((effect, other)) in missing for other in chosen)
                for effect in map(str, random.permutation(effects))
                if effect not in chosen and not any(frozenset((effect, other)) in apart for other in chosen)
            }
            chosen.append(max(new, key=lambda effect: new[effect]))
        for pair in itertools.combinations(chosen, 2):
            missing.pop(frozenset(pair), None)
        found.append(tuple(map(str, random.permutation(chosen))))
    random.shuffle(found)
    return found
