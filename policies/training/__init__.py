"""Agents and how they learn: a population of soft actor-critic agents on pendulums of their own.

population   agents trained together; training: the best of several
pendulums    what they train on; batched_env: the same for other learners
sac          their learners, over stack (networks in one tensor), replay, feed (random numbers), replayed (CUDA graphs)
definition   the same losses by TorchRL, over networks
processor    settings of a CPU
"""
