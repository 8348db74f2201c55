"""Figures: one style, one panel grid."""
