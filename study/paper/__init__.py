"""The paper's sweep, run again and held against what was published.

presets, protocol         operating points, budgets, widths, seeds; the paper's pendulum, and how it is measured
sweep                     n rollouts become theta_hat, and agents train on it: the experiment
reference_controllers     what is allowed
sweep_findings            what the runs of an operating point say; paper_figures, sweep_page: how it is told

published_numbers, finished_runs      what was printed, and the authors' runs, ours and those from elsewhere
agreement, claims         cells and contrasts compared, and what the paper says beside its table
identification_scatter    what its identification does; saturation_budget: how many rollouts three identifiers need
reproduction              all of it for a finished preset
"""
