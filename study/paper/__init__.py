"""The paper's sweep, run again and held against what was published.

presets          operating points, budgets, widths, seeds, training settings
protocol         the paper's pendulum, and how it is measured
runs             n rollouts become theta_hat, and agents train on it; reference_controllers: what the plant allows
sweep            all of it as an experiment, and what is kept; imported_runs: runs from elsewhere
findings         what the runs of an operating point say; sweep_report, figures: how it is told

published_numbers         what was printed, as facts with their places
published_runs            the authors' runs and ours, read into one table
agreement                 cells and contrasts compared, and the table of the operating points
claims                    what the paper says beside its table; identification_scatter: what identification does
saturation_budget         how many rollouts each of three identifiers needs
reproduction              all of it for a finished preset
"""
