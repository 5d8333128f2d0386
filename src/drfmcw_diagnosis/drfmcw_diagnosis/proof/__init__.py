"""The concealed-effect challenge: recordings by physics written anew, with sealed truths.

Nothing here shares forward code with the simulator or the engine; test/test_proof_generator.py inspects the imports.
"""
