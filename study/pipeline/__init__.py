"""The way of every experiment: plan -> tasks -> results -> report.

stages           an experiment as stages of tasks, what runs it to its end, and how far that is
settings         frozen plain data that results are tied to, and versions of what made a number
executor         what runs tasks: processes of this machine, or a cluster
population_task  a task that trains one population, with checkpoint and policies
database         a results folder: one SQLite file, whose tables are of tables
tables           rows of dataclasses in a database and as CSV
publication      what is told of an experiment: tables, figures, study.json, page and console
"""
