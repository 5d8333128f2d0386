"""What is concealed: effects of the registry and others, alone and together, with their sizes.

In: a seed and counts. Out: cases, each with a scene, a sealed truth and its matched signal-to-noise ratio. It shares no
forward code with the simulator or the diagnosis.
"""
