"""Agents and how they learn: a population of soft actor-critic agents on pendulums of their own.

program        from a model to a policy: the best of several agents
population     agents trained together; checkpoint: an unfinished one on disk
sac            their learners, over networks (all in one tensor), replay, random_blocks (random numbers) and cuda_graph
torchrl_reference   the same losses by TorchRL
cpu_settings   settings of a CPU
"""
