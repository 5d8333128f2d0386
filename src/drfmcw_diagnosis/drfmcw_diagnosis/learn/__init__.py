"""The measured remainder: what no effect explains of a recording, learnt from it where it repeats.

In: a `Comparison`, the effects of its explanation, and what they leave beyond chance. Out: `Learnt`: a model that the
simulator reads, how smooth it is, and how far it holds at distances that it was not learnt from.
"""
