"""Diagnosis: which effect is missing, how large it is and whether it matters."""
