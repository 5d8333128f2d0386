"""Finding what the model of a recording leaves out."""
