"""What a results folder holds.

store         every finished run in one SQLite file
policy_files  the trained policies
imports       runs taken up from elsewhere
"""
