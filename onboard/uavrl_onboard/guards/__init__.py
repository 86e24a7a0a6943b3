"""Filters between what a policy asks for and what is flown: map, evasion, shield."""
