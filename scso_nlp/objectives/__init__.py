"""Objectives: what the solver minimises, one file per term."""
