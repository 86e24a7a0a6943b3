"""Collectors of whole episodes, in the learner's process or in others."""
