"""Electromyography beside a solution: envelopes, groups of muscles, measures of agreement, their table."""
