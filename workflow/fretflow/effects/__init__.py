"""The physics that the baseline leaves out, one file an effect; a model is the baseline and a set of effects."""
