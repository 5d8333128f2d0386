"""The concealed-effect challenge: recordings by physics written anew, with sealed truths.

`generator` makes the samples of both stations, `effects` changes a scene, `sizes` computes the matched signal-to-noise
of a change, `cases` lists what is concealed, `recordings` writes and seals. Nothing here shares forward code with the
simulator or the engine; test/test_proof_generator.py inspects the imports.
"""
