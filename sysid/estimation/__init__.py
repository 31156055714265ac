"""Estimation of a model that is pushed by a random torque: one linearised problem, one filter, one solver."""
