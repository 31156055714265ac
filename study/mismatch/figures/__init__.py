"""Figures of the mismatch experiment.

experiment     every strategy at every hidden plant, and the ladder from the prior to the oracle
trajectories   two policies on a hidden plant, and all of these drawn into a folder
effect_cost    what each effect costs the policy that does not know it
naming         how many rollouts it takes to name an effect
"""
