"""The paper's sweep, run again and held against what was published.

presets, protocol         operating points, budgets, widths, seeds; the paper's pendulum, and how it is measured
runs                      n rollouts become theta_hat, and agents train on it; reference_controllers: what is allowed
sweep                     all of it as an experiment; imported_runs: runs from elsewhere
sweep_findings            what the runs of an operating point say; sweep_figures, sweep_page: how it is told

published_numbers, finished_runs      what was printed, and the authors' runs and ours in one table
agreement, claims         cells and contrasts compared, and what the paper says beside its table
identification_scatter    what its identification does; saturation_budget: how many rollouts three identifiers need
reproduction              all of it for a finished preset; publication_figures
"""
