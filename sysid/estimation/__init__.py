"""Estimation: from records to a fitted model with its uncertainty, by one solver of one linearised problem."""
