"""An independent generator of recordings.

In: a scene of two stations. Out: samples and recordings. It shares no forward code with the simulator or the diagnosis;
test_proof_generator.py inspects the imports.
"""
