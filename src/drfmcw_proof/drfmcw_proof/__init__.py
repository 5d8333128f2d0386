"""The proof of the diagnosis: effects concealed in recordings by physics written anew, with sealed truths.

`generator` makes the samples of both stations; `cases` lists what is concealed and computes its matched signal-to-noise
ratio; `judging` compares a finding with the truth; `prove` runs the list; `report` writes docs/proof.md.
"""
