"""What the experiments on hidden plants share: rollouts -> training setup.

hidden_plant    machines with an effect that the simulator lacks; ground_truth: how they move; outside_effects
rollout_budget  what can be made of n rollouts: a training_setup, of which one has a learned_torque
"""
