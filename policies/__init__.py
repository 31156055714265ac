"""Controllers for the pendulum: environments, training and references, over the models of sysid.

The names below load their modules on first use, so that `import policies` stays cheap and does not load torch.
"""
