"""Does breadth pay when the simulator lacks an effect?

What an effect costs, before any training:
    magnitudes       the effects, each over its size
    effect_cost      their price by dynamic programming, over their sizes

The experiment:
    plan             plants, strategies, seeds and contrasts
    ground_truth     the hidden plants as machines, their rollouts and designs
    strategies       what each strategy makes of its budget of rollouts: a TrainingSetup
    residual_network a learned torque, fitted by network_fit
    trainings        setups, and the agents that train on them together
    experiment       all of it as tasks, dynamic programs in the place of training too; mismatch_results: what is kept
    findings         returns, contrasts, parts of a gap; sentences, figures, mismatch_report: how they are told

How many rollouts naming takes:
    naming           measures it; naming_results: its rows, and what is right
"""
