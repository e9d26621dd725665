"""Learners in numpy alone, one a module that is read from top to bottom, and the little that they have in common."""
