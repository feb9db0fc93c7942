"""Whether recordings that no fit saw pull towards what a candidate changes: a score test.

A candidate fitted to one half foretells the other worse than it might, by as much as its values are uncertain: where it
is small beside the noise, that is what it gains. The direction that it found is free of this. A held-out window asks
for it if its residual, as the model without the candidate leaves it, points against the change; in a model that lacks
nothing it points anywhere (Rao, Proc. Camb. Phil. Soc. 1948; with parameters to be fitted, Neyman's C(alpha), 1959).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from nfpde.gap.noise import learn_scatter
from nfpde.gap.screen import span_of
from nfpde.gap.trial import Court, Trial, block_test

Array = NDArray[np.float64]


class HeldScore:
    """The held-out windows as a model leaves them, without what its own parameters could do there.

    Args:
        court: Judges.
        current: The model, without any of the candidates.
    """

    def __init__(self, court: Court, current: Trial) -> None:
        self._block = court.block
        fit = court.held.start(current.fit.replay, current.fit.xi[None], current.fit.scatter)
        self._fit = court.held.linearise(replace(fit, information=current.fit.information))
        self._scatter = learn_scatter(current.held, 0, court.floor)
        self._white = self._scatter.whiten(current.held)
        self._weights = self._scatter.weights(self._white)

    def p_value(self, trial: Trial) -> float:
        """Probability that what a candidate changes agrees so well by chance, by the scores of blocks; one-sided.

        Args:
            trial: The candidate beside the model, fitted to the other half.
        """
        return block_test(self.scores(trial), self._block)[2]

    def scores(self, trial: Trial) -> Array:
        """Slope of the log density of every held-out window along a candidate's change, where it begins (N,)."""
        change = self._scatter.whiten(trial.held) - self._white
        # a jump that the candidate alone makes is to count no more than one that is there
        root = np.sqrt(np.minimum(self._weights, self._scatter.weights(change)))[..., None]
        span = span_of(self._fit, self._scatter, root)

        def free(part: Array) -> Array:
            rows = (part * root).ravel()
            return (rows - span @ (span.T @ rows)).reshape(len(part), -1)

        return -(free(self._white) * free(change)).sum(1)
