"""Figures of the sweep.

sweeps            heat map and best width of one sweep, or of two side by side; reference_lines: optimum, swing-up, LQR
operating_point   what a finished operating point shows
side_by_side      this study beside the published one         identification   how the grid search scatters
"""
