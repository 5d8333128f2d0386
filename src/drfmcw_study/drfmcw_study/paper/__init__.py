"""The figures of the paper, simulated, drawn and compared with what the paper claims.

In: the number of trials, the seed and the estimator (`experiments.Run`). Out: per figure its points to simulate and,
from their outcomes, a plot, a paragraph, a table and claims (`catalogue.SECTIONS`).
"""
