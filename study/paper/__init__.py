"""The published study and this one.

paper       what was printed, as facts with their places
published   the authors' runs and ours, read into one table
agreement   cells and contrasts compared, and the table of the operating points
claims      what the paper says beside its table, answered in sentences; scatter measures what identification does
knee        what a rollout is worth to three identifiers
held        all of it for a finished preset; page puts it into the report
"""
