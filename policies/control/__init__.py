"""Controllers that know their model: LQR, energy swing-up, and dynamic programming, also behind dead time.

dynamic_programming   over a table; predictive: through the commands under way
lqr                   about the upright; swing_up: by energy, then LQR
references            what all of them return on a model         design_model: the step that they are designed on
"""
