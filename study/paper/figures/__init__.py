"""Figures of the sweep.

sweeps        what a finished operating point shows, alone or beside the published sweep
publication   contrasts there and here, how the grid search scatters, three identifiers
"""
