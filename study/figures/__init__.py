"""The study's figures.

style          colours, fonts, and how a figure becomes a file
references     optimal, swing-up and LQR, drawn the same way everywhere
sweeps         heat map and best width of one sweep, or of two side by side
answers        what a finished operating point shows
publication    this study beside the published one
claims         what the paper says beside its table
effect_cost    what each effect costs the policy that does not know it
mismatch       every way of the mismatch experiment, and the ladder; trajectories: two policies on a hidden plant
naming         how many rollouts it takes to name an effect
"""
