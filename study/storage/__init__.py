"""What a results folder holds.

database      one SQLite file, tied to what its numbers depend on; whatever tables a study needs
store         every finished run in such a file
policy_files  the trained policies
imports       runs taken up from elsewhere
"""
